"""Common properties of all errors."""

import importlib
import pickle
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import stkzoo
from stkzoo import errors, race_v0
from stkzoo.race import RaceSettings, run_race

ALL = [getattr(errors, name) for name in errors.__all__]
CLASSES = [entry for entry in ALL if isinstance(entry, type)]


def all_errors():
    """Returns all exception classes of the package, including those outside ``errors.py``."""
    root = Path(stkzoo.__file__).parent
    for file in sorted(root.glob("*/**/*.py")):
        if re.search(r"^class \w+\(.*(Error|Exception)\b", file.read_text(), re.MULTILINE):
            importlib.import_module(".".join(file.relative_to(root.parent).with_suffix("").parts))
    kinds = [errors.StkzooError]
    for kind in kinds:
        kinds += [below for below in kind.__subclasses__() if below not in kinds]
    return sorted(kinds, key=lambda kind: kind.__qualname__)


EVERY = all_errors()


def test_errors_outside_their_module_are_found():
    names = {kind.__name__ for kind in EVERY}
    assert names > {"BatchError", "ReplayError", "VideoError"}


@pytest.mark.parametrize("kind", EVERY)
def test_an_error_can_be_created_from_its_text_and_pickled(kind):
    error = kind("what happened")
    # AsyncVectorEnv raises exctype(value), where value is the error itself.
    for copy in (error, pickle.loads(pickle.dumps(error)), kind(error)):
        assert (type(copy), str(copy)) == (kind, "what happened")
        assert vars(copy).keys() == vars(error).keys()


@pytest.mark.parametrize(
    "error",
    [
        errors.ActionError("text", "kart_0"),
        errors.EngineCrashed("text", "the game's log"),
        errors.AgentTimeout("text", "kart_1", "a trace"),
        errors.ProtocolError("text"),
    ],
)
def test_a_pickled_error_keeps_its_text_and_attributes(error):
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), vars(copy)) == (type(error), str(error), vars(error))


def test_the_tree_in_the_docstring_lists_every_error_below_its_parent():
    indents = {}
    for line in errors.__doc__.splitlines():
        words = line.strip("│├└─ ").split()
        if words and hasattr(errors, words[0]):
            indents[words[0]] = len(line) - len(line.lstrip(" │├└─"))
    assert set(indents) == {kind.__name__ for kind in CLASSES}
    for kind in CLASSES[:]:
        if kind is not errors.StkzooError:
            assert indents[kind.__mro__[1].__name__] == indents[kind.__name__] - 4


@pytest.mark.parametrize("value", [True, "1", None, float("nan"), 0, -1, float("inf"), 10**400])
def test_values_other_than_positive_numbers_are_refused(value):
    with pytest.raises(
        errors.ConfigError, match=r"wait is .*, expected a number of seconds above 0"
    ):
        errors.check_number("wait", value, unit="seconds")


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "0"])
def test_a_number_out_of_its_bounds_is_refused(value):
    with pytest.raises(errors.ConfigError, match=r"share is .*, expected a number from 0 to 1"):
        errors.check_number("share", value, 0, 1)


class Broken:
    def __repr__(self):
        raise ValueError


@pytest.mark.parametrize(
    "value",
    [
        *(None, 1.5, "it's", b"x", [], (), {}, set(), (1,), [1, "a", (2, [None])]),
        *({"b": 1, "a": [b"x"]}, np.zeros(3), np.float32(1), {1}, range(3)),
    ],
    ids=repr,
)
def test_a_short_value_is_shown_as_its_repr(value):
    assert errors.shortened(value) == repr(value)


def test_a_long_value_is_cut():
    assert errors.shortened(["x"] * 100, 20) == "['x', 'x', 'x', '..."


def test_a_large_array_is_shown_as_its_shape_and_dtype():
    text = "an array of shape (7, 7, 7, 7) and dtype int8"
    assert errors.shortened(np.zeros([7] * 4, np.int8)) == text


def test_a_value_whose_repr_fails_is_named():
    assert errors.shortened([1, Broken()]) == "(list: its __repr__ failed)"


@pytest.mark.parametrize(
    ("make", "wrong", "meant"),
    [
        (race_v0.parallel_env, "numkart", "num_kart"),
        (lambda **options: gym.make("supertuxkart/simple-v0", **options), "lap", "laps"),
        (lambda **options: stkzoo.RaceVectorEnv(2, **options), "revers", "reverse"),
        (lambda **options: run_race(["ai"], **options), "max_step", "max_steps"),
        (stkzoo.AgentSpec, "rankstart", "rank_start"),
        (RaceSettings, "trak", "track"),
        (stkzoo.MonoAgentWrapperAdapter, "wraper_factories", "wrapper_factories"),
    ],
)
def test_an_unknown_keyword_is_reported_with_the_nearest_name(make, wrong, meant):
    with pytest.raises(errors.ConfigError) as caught:
        make(**{wrong: 1})
    assert f"{wrong!r}. Did you mean {meant!r}?" in str(caught.value)
    assert "\n" not in str(caught.value)
