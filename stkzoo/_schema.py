"""Types with bounds for the fields of documents, and texts that are safe for a terminal.

msgspec checks the bounds when it decodes a document.

>>> import msgspec
>>> msgspec.convert(3, Place)
3
>>> msgspec.convert(0, Place)
Traceback (most recent call last):
    ...
msgspec.ValidationError: Expected `int` >= 1
"""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Iterable
from typing import Annotated

from msgspec import Meta

#: Limit of whole numbers. Larger ones do not fit into arrays.
_MAX_WHOLE = 2**63 - 1
#: Letters that :func:`plain_text` replaces.
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
#: Such letters in JSON text, where they may be escaped. The group is to be kept: an escaped
#: backslash, or the two halves of a letter.
_CONTROL_IN_JSON = re.compile(
    r"""( \\\\ | \\u[dD][89abAB]..\\u[dD][c-fC-F].. )
    | \\[bfr]
    | \\u00(?: 0[0-8b-fB-F] | 1. | 7[fF] | [89]. )
    | \\u20(?: 2[89a-eA-E] | 6[6-9] )
    | \\u[dD][89a-fA-F]..
    | [\x7f-\x9f\u2028-\u202e\u2066-\u2069]""",
    re.VERBOSE,
)

#: Terminal escape sequences, such as colors and window titles.
ESCAPES = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?)")
#: Maximum length of a name that people read [characters].
_MAX_NAME = 32

#: Common types with bounds.
Count = Annotated[int, Meta(ge=0, le=_MAX_WHOLE)]
Whole = Annotated[int, Meta(ge=1, le=_MAX_WHOLE)]
Level = Annotated[int, Meta(ge=0, le=3)]
Place = Annotated[int, Meta(ge=1, le=256)]
Positive = Annotated[float, Meta(gt=0)]
Seconds = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]


def matching(pattern: str) -> Meta:
    """Returns the constraint that a whole text matches a regular expression."""
    return Meta(pattern=rf"^(?:{pattern})\Z")


def one_of(*texts: str) -> Meta:
    """Returns the constraint that a text is one of several."""
    return matching("|".join(map(re.escape, texts)))


def plain_text(text: str) -> str:
    """Returns a text in which ``?`` replaces codes that could affect a terminal.

    These are control codes except line feeds and tabs, line and paragraph separators, codes that
    change the direction of text, and bytes that are not UTF-8.
    """
    return text if text.isprintable() else _CONTROL.sub("?", text)


def plain_name(text: object, limit: int = _MAX_NAME) -> str:
    """Returns the name of an agent, a team, a file or a server as people can read it.

    It is one line in Unicode's normal form NFKC, without codes and marks of direction. It may be
    empty.

    Args:
        text: the name, from anybody.
        limit: maximum length [characters].
    """
    name = unicodedata.normalize("NFKC", ESCAPES.sub("", str(text)[: 8 * limit]))
    seen = (letter for letter in name if letter.isprintable() or letter.isspace())
    return " ".join("".join(seen).split())[:limit].strip()


def distinct_name(name: str, taken: Iterable[str]) -> str:
    """Returns a name, with a number if another one differs at most in case: ``Ada-2``.

    Args:
        name: the name, as :func:`plain_name` returns it.
        taken: the other names.
    """
    others = {other.casefold() for other in taken}
    names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
    return next(name for name in names if name.casefold() not in others)


def plain_json(text: str) -> str:
    """Returns JSON text after replacing these codes in its texts, as :func:`plain_text` does."""
    return _CONTROL_IN_JSON.sub(lambda code: code[1] or "?", text)
