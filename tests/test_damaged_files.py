"""Damaged files of every kind raise one error that names the file, in bounded memory."""

import json
import os
import random
import re
import tracemalloc
from dataclasses import fields

import jsonschema
import pytest
from referencing import Registry, Resource

from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation import BenchmarkResult, TimeTrialResult, TournamentResult
from stkzoo.evaluation.benchmark.ai_times import AiTimes
from stkzoo.race import RaceResult
from stkzoo.suite import Entry
from tests.support.file_kinds import KINDS
from tests.support.mutations import mutate, run_kind
from tests.support.paths import SCHEMAS

JSON_KINDS = [name for name, kind in KINDS.items() if kind.is_json]
LINES = ("tuning log", "matches", "training log")


def with_number(text, number):
    """Returns the text with its first number replaced."""
    return re.sub(r"(?<=[:\[ ])\d[\d.]*(?=[,\]\s}])", number, text, count=1).encode()


#: Damages to a file, as bytes or as a function of its text.
DAMAGES = {
    "empty": b"",
    "truncated": lambda text: text[: len(text) // 2].encode(),
    "a number": b"3",
    "a list of nothing": b"[null]",
    "an empty object": b"{}",
    "nested 100,000 deep": b"[" * 100_000,
    "objects 100,000 deep": b'{"a":' * 100_000,
    "NaN": lambda text: with_number(text, "NaN"),
    "infinity": lambda text: with_number(text, "-Infinity"),
    "a huge whole number": lambda text: with_number(text, "9" * 10_000),
    "UTF-16": lambda text: text.encode("utf-16"),
    "Latin-1": lambda text: b"\xe9" + text.encode(),
}
#: Combinations that are valid.
VALID = {
    *(
        (name, damage)
        for name in LINES
        for damage in ("empty", "truncated", "objects 100,000 deep")
    ),
    *((name, "an empty object") for name in ("tuned plans", "arguments")),
}


def refused(kind, file):
    """Returns the message of the error that reading a file raises."""
    with pytest.raises(StkzooError) as caught:
        kind.read(file)
    message = str(caught.value)
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", JSON_KINDS)
def test_a_damaged_file_raises_one_error_that_names_it(tmp_path, name, damage):
    kind = KINDS[name]
    if (name, damage) in VALID:
        pytest.skip("it is valid")
    change = DAMAGES[damage]
    file = kind.store(tmp_path, change if isinstance(change, bytes) else change(kind.valid()))
    assert file.name in refused(kind, file)


@pytest.mark.parametrize("name", KINDS)
def test_a_one_gigabyte_file_is_refused_with_little_memory(tmp_path, name):
    kind = KINDS[name]
    file = kind.write(tmp_path, kind.valid())
    kind.read(file)
    os.truncate(file, 1 << 30)
    tracemalloc.start()
    try:
        assert file.name in refused(kind, file)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


# ---------------------------------------------------------------------- results


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("rank", -5, r"agents\[0\].rank is -5, expected a value from 1 to 256"),
        ("rank", "first", r"agents\[0\].rank is 'first', expected a whole number"),
        ("finish_time", "soon", r"agents\[0\].finish_time is 'soon', expected a finite number"),
        ("finish_time", -1.0, r"agents\[0\].finish_time is -1.0, expected a value above 0"),
        ("status", "lost", r"status is 'lost', expected one of finished, racing, retired"),
        ("agent", "me", "agent is 'me', expected an agent's id such as kart_0"),
        ("num_errors", True, "num_errors is True, expected a whole number"),
        ("errors", [{"step": 0}], r"agents\[0\].errors\[0\].kind is missing"),
        ("laps", 10**30, "laps is 1000.*, expected a whole number"),
    ],
)
def test_an_invalid_field_of_a_result_is_refused_and_named(field, value, problem):
    values = json.loads(KINDS["race-result"].valid())
    values["agents"][0][field] = value
    with pytest.raises(ConfigError, match=f"the text has no race result .*{problem}"):
        RaceResult.from_json(json.dumps(values))


@pytest.mark.parametrize(
    "kind", [RaceResult, AiTimes, BenchmarkResult, TimeTrialResult, TournamentResult, Entry]
)
def test_values_that_break_the_published_schema_are_refused(kind):
    """A change that breaks the schema is refused. Missing entries do not count as a break."""
    schema = json.loads((SCHEMAS / f"{kind.kind}.schema.json").read_text())
    if kind is RaceResult:
        del schema["oneOf"]
        schema["$ref"] = "#/$defs/race"
    validator = jsonschema.Draft202012Validator(schema, registry=published_schemas())
    source, valid = random.Random(1), json.loads(KINDS[kind.kind].valid())
    validator.validate(valid)
    own = {entry.name: valid[entry.name] for entry in fields(kind)}
    checked = 0
    for _ in range(100):
        changed = mutate(own, source)
        text = json.dumps(valid | changed if isinstance(changed, dict) else changed)
        problems = [e for e in validator.iter_errors(json.loads(text)) if e.validator != "required"]
        if problems:
            checked += 1
            place = list(problems[0].absolute_path)
            assert is_refused(kind, text), f"{place}: {problems[0].message[:200]}"
    assert checked > 30


def published_schemas():
    """Returns all published schemas, to which a schema may refer."""
    schemas = [json.loads(file.read_text()) for file in SCHEMAS.glob("*.json")]
    found = [Resource.from_contents(schema) for schema in schemas]
    return Registry().with_resources((schema.id(), schema) for schema in found)


def is_refused(kind, text):
    try:
        kind.from_json(text)
    except ConfigError:
        return True
    return False


# ---------------------------------------------------------------------- mutations


@pytest.mark.parametrize("name", KINDS)
def test_mutations_raise_only_expected_errors(tmp_path, name):
    outcome = run_kind(KINDS[name], 15, 1, tmp_path)
    assert outcome.findings == []
    assert outcome.refused + outcome.read == 15
