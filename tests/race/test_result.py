"""Results become valid JSON, whatever texts they contain."""

import json
from dataclasses import replace

import jsonschema
import pytest

from stkzoo.errors import ConfigError
from stkzoo.race import AgentFailure, RaceResult, run_race
from tests.support.paths import SCHEMAS

SCHEMA = json.loads((SCHEMAS / "race-result.schema.json").read_text())
ODD_TEXTS = ["\udc80\ud800", "\0\x1b[2J", "\U0001f3c1 ", "x" * 5_000_000, "\ufffe"]


@pytest.fixture(scope="module")
def result():
    return run_race(["random", "ai"], track="lighthouse", max_steps=3, seed=1)


def read_strictly(text):
    """Parses a text as standard JSON, without Python's extensions."""

    def refuse(word):
        raise AssertionError(f"{word} is no JSON")

    value = json.loads(text, parse_constant=refuse)
    json.dumps(value, ensure_ascii=False).encode()  # no lone surrogate
    return value


def test_a_result_without_a_mode_is_a_normal_race(result):
    values = json.loads(result.to_json())
    del values["mode"]
    assert RaceResult.from_json(json.dumps(values)) == result


@pytest.mark.parametrize("mode", ["soccer", 1, None])
def test_a_result_with_an_unknown_mode_is_refused(result, mode):
    values = json.loads(result.to_json()) | {"mode": mode}
    with pytest.raises(ConfigError, match=r"\$\.mode"):
        RaceResult.from_json(json.dumps(values))


def with_agent(result, **changes):
    first, *others = result.agents
    return replace(result, agents=(replace(first, **changes), *others))


@pytest.mark.parametrize("text", ODD_TEXTS, ids=lambda text: ascii(text[:10]))
@pytest.mark.parametrize("name", ["driver", "source"])
def test_any_text_becomes_valid_json(result, text, name):
    value = read_strictly(with_agent(result, **{name: text}).to_json())
    jsonschema.validate(value, SCHEMA)


def test_any_error_text_of_an_agent_becomes_valid_json(result):
    failure = AgentFailure(0, "error", "\udcff", "\ud83d")
    value = read_strictly(with_agent(result, errors=(failure,), num_errors=1).to_json())
    jsonschema.validate(value, SCHEMA)
