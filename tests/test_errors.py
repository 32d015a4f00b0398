"""What all errors have in common."""

import pickle

import pytest

from stkzoo import errors

ALL = [getattr(errors, name) for name in errors.__all__]
CLASSES = [entry for entry in ALL if isinstance(entry, type)]


@pytest.mark.parametrize("kind", CLASSES)
def test_an_error_is_made_from_its_text_alone(kind):
    assert str(kind("what happened")) == "what happened"


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


def test_the_tree_at_the_top_names_every_error_below_its_parent():
    indents = {}
    for line in errors.__doc__.splitlines():
        words = line.strip("│├└─ ").split()
        if words and hasattr(errors, words[0]):
            indents[words[0]] = len(line) - len(line.lstrip(" │├└─"))
    assert set(indents) == {kind.__name__ for kind in CLASSES}
    for kind in CLASSES[:]:
        if kind is not errors.StkzooError:
            assert indents[kind.__mro__[1].__name__] == indents[kind.__name__] - 4
