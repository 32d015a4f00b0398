"""Bounds of common types, and texts that are safe for a terminal."""

import json
from typing import Annotated

import msgspec
import pytest

from stkzoo._schema import (
    Count,
    distinct_name,
    matching,
    one_of,
    plain_json,
    plain_name,
    plain_text,
)

CODES = "a\x1b[2Jb\n\t\r\x7f\x9b\u2028\u202ecba\u2066"


@pytest.mark.parametrize("number", [-1, 2**63, True, 1.0])
def test_a_count_fits_into_an_array(number):
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(number, Count)


@pytest.mark.parametrize("bound", [matching("ab|cd"), one_of("ab", "cd")])
@pytest.mark.parametrize("text", ["abx", "xcd", "ab\n", ""])
def test_a_pattern_is_for_the_whole_text(bound, text):
    assert msgspec.convert("ab", Annotated[str, bound]) == "ab"
    with pytest.raises(msgspec.ValidationError, match="matching regex"):
        msgspec.convert(text, Annotated[str, bound])


def test_control_codes_are_replaced():
    assert plain_text(CODES + "\udcff") == "a?[2Jb\n\t?????cba??"


def test_joiners_and_special_spaces_in_text_are_kept():
    text = "\u0639\u0644\u06cc\u200c\u0631\u0636\u0627 \u00a0\u00ad\U0001f469\u200d\U0001f680"
    assert plain_text(text) == text


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("\uff21\uff44\uff41", "Ada"),
        ("\u202eA\u2066d\u200ba\ufeff\u00ad\u200f", "Ada"),
        ("\x1b[31mAda\x1b]0;x\x07\x9b \t\n\u2028 Bob\x7f", "Ada Bob"),
        ("a" * 40, "a" * 32),
        ("\ufb03" * 20, "ffi" * 10 + "ff"),
        ("\u5c0f\u660e \u0410\u0434\u0430", "\u5c0f\u660e \u0410\u0434\u0430"),
        ("\udcff\ue000", ""),
    ],
)  # fmt: skip
def test_a_name_is_one_line_without_codes(text, name):
    assert plain_name(text) == name
    assert plain_name(name) == name


@pytest.mark.parametrize(("one", "two"), [("Ada", "ADA"), ("Stra\u00dfe", "strasse")])
def test_names_that_differ_only_in_case_get_a_number(one, two):
    assert distinct_name(two, [one]) == f"{two}-2"
    assert distinct_name(one, [two, f"{one}-2"]) == f"{one}-3"
    assert distinct_name(one, ["Eva", f"{one}x"]) == one


@pytest.mark.parametrize("text", [CODES, "\\u001b", "\\\\\x1b", "\U0001f680 \ud83d", "\udcff"])
def test_control_codes_in_json_are_replaced(text):
    plain = plain_json(json.dumps({text: [text]}))
    assert json.loads(plain) == {plain_text(text): [plain_text(text)]}


def test_control_codes_that_are_not_escaped_are_replaced():
    plain = plain_json(json.dumps(CODES, ensure_ascii=False))
    assert json.loads(plain) == plain_text(CODES)
