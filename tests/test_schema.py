"""JSON values become dataclasses only if all fields have valid types and values."""

import sys
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import pytest

from stkzoo._reading import Unreadable
from stkzoo._schema import Matching, OneOf, Place, Positive, Within, typed
from stkzoo.errors import ConfigError, check_whole


@dataclass(frozen=True)
class Wheel:
    size: Positive


@dataclass(frozen=True)
class Cart:
    place: Place
    kind: Annotated[str, OneOf(("fast", "slow"))] = "fast"
    name: Annotated[str, Matching("[a-z]+", "small letters"), Within(0, 8)] = "ada"
    time: Positive | None = None
    wheels: Annotated[tuple[Wheel, ...], Within(0, 4)] = ()
    costs: Mapping[str, float] = ()
    corner: tuple[int, bool] = (0, False)
    notes: list[str] = ()
    more: Any = None

    def __post_init__(self):
        check_whole("place", self.place, 1, 99)


def test_a_good_value_is_read():
    value = {
        "place": 2,
        "kind": "slow",
        "name": "bob",
        "time": 1,
        "wheels": [{"size": 0.5}],
        "costs": {"a": 1.5},
        "corner": [1, True],
        "notes": ["x"],
        "more": {"a": [1, None]},
        "unknown": 1,
    }
    expected = Cart(2, "slow", "bob", 1, (Wheel(0.5),), {"a": 1.5}, (1, True), ["x"], value["more"])
    assert typed(Cart, value) == expected


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"place": "first"}, "place is 'first', expected a whole number"),
        ({"place": True}, "place is True, expected a whole number"),
        ({"place": 1.0}, "place is 1.0, expected a whole number"),
        ({"place": -5}, "place is -5, expected a value from 1 to 256"),
        ({"place": 100}, "place is 100, expected a whole number from 1 to 99"),
        ({"place": 2**64}, "expected a whole number"),
        ({"kind": "red"}, "kind is 'red', expected one of fast, slow"),
        ({"name": "Ada"}, "name is 'Ada', expected small letters"),
        ({"name": "a" * 1000}, "expected a length from 0 to 8"),
        ({"time": "soon"}, "time is 'soon', expected a finite number"),
        ({"time": float("nan")}, "time is nan, expected a finite number"),
        ({"time": 0}, "time is 0, expected a value above 0"),
        ({"wheels": [{"size": 1}, {}]}, r"wheels\[1\].size is missing"),
        ({"wheels": [{"size": 1}] * 5}, "expected a length from 0 to 4"),
        ({"wheels": {}}, "wheels is {}, expected a list"),
        ({"wheels": [3]}, r"wheels\[0\] is 3, expected an object"),
        ({"costs": {"b": None}}, "costs.b is None, expected a finite number"),
        ({"costs": []}, r"costs is \[\], expected an object"),
        ({"corner": [1]}, r"corner is \[1\], expected a list of 2"),
        ({"notes": "x"}, "notes is 'x', expected a list"),
        ({"more": [[[[[[[[[[[[[[[[[1]]]]]]]]]]]]]]]]]}, "more is nested too deep"),
        ({"more": 2**70}, "more is .*, expected a finite number"),
    ],
)
def test_a_bad_value_is_refused_with_its_field(change, problem):
    with pytest.raises(Unreadable, match=problem):
        typed(Cart, {"place": 1, **change})


def test_a_missing_field_is_named():
    with pytest.raises(Unreadable, match=r"^place is missing$"):
        typed(Cart, {})


def test_control_codes_are_removed_from_text():
    assert typed(list[str], ["a\x1b[2Jb\n", "\u202ecba\udcff"]) == ["a?[2Jb\n", "?cba?"]


def test_joiners_and_special_spaces_in_text_are_kept():
    text = "\u0639\u0644\u06cc\u200c\u0631\u0636\u0627 \u00a0\u00ad\U0001f469\u200d\U0001f680"
    assert typed(str, text) == text


def test_the_error_of_a_class_names_its_position():
    with pytest.raises(Unreadable, match=r"^\[1\] place is 100"):
        typed(tuple[Cart, ...], [{"place": 1}, {"place": 100}])


def test_a_huge_value_is_not_shown_in_full():
    with pytest.raises(Unreadable) as caught:
        typed(Wheel, [list(range(10_000))] * 1000)
    assert len(str(caught.value)) < 120


def test_a_config_error_of_the_class_is_not_lost():
    with pytest.raises(ConfigError):
        Cart(0)


@pytest.mark.skipif(sys.version_info < (3, 12), reason="this Python has no aliases with parameters")
def test_an_alias_is_read_as_its_type():
    """As NDArray is since NumPy 2.5, which made replays unreadable."""
    kind = typing.TypeVar("kind")
    pairs = typing.TypeAliasType("pairs", tuple[kind, kind], type_params=(kind,))
    assert typed(pairs[int], [1, 2]) == (1, 2)
    with pytest.raises(Unreadable, match="expected a whole number"):
        typed(pairs[int], [1, 2.5])
