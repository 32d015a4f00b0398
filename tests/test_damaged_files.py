"""Damaged files of every kind raise one error that names the file, in bounded memory."""

import json
import os
import random
import re
import stat
import tracemalloc
from dataclasses import fields
from pathlib import Path

import jsonschema
import pytest
from referencing import Registry, Resource

from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation import BenchmarkResult, TournamentResult
from stkzoo.evaluation.batch.order import replay_file
from stkzoo.race import RaceResult
from stkzoo.suite import Entry
from stkzoo.suite.entry import replay_digest
from tests.support.file_kinds import KINDS
from tests.support.mutations import mutate, run_kind
from tests.support.paths import SCHEMAS

JSON_KINDS = [name for name, kind in KINDS.items() if kind.is_json]


def truncated(text):
    return text[: len(text) // 2].encode()


def refused(kind, file):
    """Returns the message of the error that reading a file raises."""
    with pytest.raises(StkzooError) as caught:
        kind.read(file)
    message = str(caught.value)
    assert len(message) < 1000
    return message


@pytest.mark.parametrize("name", JSON_KINDS)
def test_a_damaged_file_raises_one_error_that_names_it(tmp_path, name):
    kind = KINDS[name]
    file = kind.store(tmp_path, truncated(kind.valid()))
    assert file.name in refused(kind, file)


@pytest.mark.slow
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


ODD = {
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "device": lambda file: file.symlink_to("/dev/zero"),
    "dangling link": lambda file: file.symlink_to("missing"),
    "endless link": lambda file: file.symlink_to(file.name),
    "socket": lambda file: os.mknod(file, stat.S_IFSOCK | 0o600),
}


@pytest.mark.parametrize("name", KINDS)
def test_an_odd_entry_in_place_of_a_file_is_one_sentence(tmp_path, name):
    kind = KINDS[name]
    file = kind.write(tmp_path, kind.valid())
    for odd, make in ODD.items():
        file.unlink() if file.is_symlink() or not file.is_dir() else file.rmdir()
        make(file)
        if name != "assets marker" or odd != "dangling link":  # data without marker is the user's
            assert file.name in refused(kind, file)


@pytest.mark.parametrize("odd", ["folder", "pipe", "dangling link", "endless link"])
def test_an_odd_replay_in_an_entry_is_refused(tmp_path, odd):
    file = replay_file(tmp_path, 0)
    file.parent.mkdir()
    ODD[odd](file)
    with pytest.raises(ConfigError, match=r"00000.stkz cannot be read; delete the result"):
        replay_digest(tmp_path, 0)


# ---------------------------------------------------------------------- results


@pytest.mark.parametrize(
    ("field", "value", "problem"),
    [
        ("rank", -5, "Expected `int` >= 1 - at `$.agents[0].rank`"),
        ("finish_time", "soon", "got `str` - at `$.agents[0].finish_time`"),
        ("status", "lost", "finished|racing|retired"),
        ("errors", [{"step": 0}], "field `kind` - at `$.agents[0].errors[0]`"),
        ("laps", 10**18 * 10, "at `$.agents[0].laps`"),
    ],
)
def test_an_invalid_field_of_a_result_is_refused_and_named(field, value, problem):
    values = json.loads(KINDS["race-result"].valid())
    values["agents"][0][field] = value
    with pytest.raises(ConfigError, match="the text has no race result .*" + re.escape(problem)):
        RaceResult.from_json(json.dumps(values))


@pytest.mark.slow
@pytest.mark.parametrize("kind", [RaceResult, BenchmarkResult, TournamentResult, Entry])
def test_values_that_break_the_published_schema_are_refused(kind):
    """A change that breaks the schema is refused. Missing entries do not count as a break."""
    schema = json.loads((SCHEMAS / f"{kind.type_name}.schema.json").read_text())
    if kind is RaceResult:
        del schema["oneOf"]
        schema["$ref"] = "#/$defs/race"
    validator = jsonschema.Draft202012Validator(schema, registry=published_schemas())
    source, valid = random.Random(1), json.loads(KINDS[kind.type_name].valid())
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
