"""Common properties of all errors."""

import importlib
import pickle
import re
from pathlib import Path

import pytest

import stkzoo
from stkzoo import errors

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
