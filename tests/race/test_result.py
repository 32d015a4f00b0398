"""Results become valid JSON, whatever they contain."""

import json
import math
import sys
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from stkzoo.errors import ConfigError
from stkzoo.race import AgentFailure, RaceResult, run_race
from tests.support.paths import SCHEMAS

SCHEMA = json.loads((SCHEMAS / "race-result.schema.json").read_text())
ODD_NUMBERS = [math.nan, math.inf, -math.inf, np.float32(1.5), np.float64("nan"), np.int64(3)]
ODD_TEXTS = ["\udc80\ud800", "\0\x1b[2J", "\U0001f3c1 ", "x" * 5_000_000, "\ufffe", np.str_("a")]


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
    with pytest.raises(ConfigError, match="mode is"):
        RaceResult.from_json(json.dumps(values))


def with_agent(result, **changes):
    first, *others = result.agents
    return replace(result, agents=(replace(first, **changes), *others))


def test_a_result_survives_json_unchanged(result):
    assert RaceResult.from_json(result.to_json()) == result


@pytest.mark.parametrize("number", ODD_NUMBERS, ids=repr)
@pytest.mark.parametrize("name", ["distance", "reward"])
def test_any_number_becomes_valid_json(result, number, name):
    value = read_strictly(with_agent(result, **{name: number}).to_json())
    jsonschema.validate(value, SCHEMA)


@pytest.mark.parametrize("text", ODD_TEXTS, ids=lambda text: ascii(text[:10]))
@pytest.mark.parametrize("name", ["driver", "source"])
def test_any_text_becomes_valid_json(result, text, name):
    value = read_strictly(with_agent(result, **{name: text}).to_json())
    jsonschema.validate(value, SCHEMA)


@pytest.mark.parametrize("count", [np.int64(7), np.uint8(7), True])
def test_any_count_becomes_valid_json(result, count):
    changed = replace(with_agent(result, laps=count, num_errors=count), steps=np.int32(3))
    assert read_strictly(changed.to_json())["steps"] == 3


def test_any_error_text_of_an_agent_becomes_valid_json(result):
    failure = AgentFailure(np.int64(0), "error", "\udcff", "\ud83d")
    value = read_strictly(with_agent(result, errors=(failure,), num_errors=1).to_json())
    jsonschema.validate(value, SCHEMA)


def test_an_object_without_a_json_form_becomes_text(result):
    class Odd:
        def __str__(self):
            raise RuntimeError

    value = read_strictly(with_agent(result, source=Odd(), driver=b"\xff").to_json())
    assert {value["agents"][0][name] for name in ("source", "driver")} == {"a Odd", "\ufffd"}


def test_infinite_numbers_become_the_largest_number(result):
    row = json.loads(with_agent(result, reward=math.inf).to_json())["agents"][0]
    assert row["reward"] == sys.float_info.max
