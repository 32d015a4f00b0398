"""Damages files of every kind that stkzoo reads.

Changes of a JSON file: a value of another type, a number out of range or not finite, a huge or
deeply nested value, a missing, repeated or renamed entry, or a truncated file. Arrays and zip files
are damaged in their parts.
"""

from __future__ import annotations

import copy
import random
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stkzoo.errors import StkzooError
from tests.support.file_kinds import FileKind

#: Replacements for a value.
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, -5, 2**31, 2**63, -(2**63), 10**400, 0.5, -0.0, 1e308, -1e308),
    *(float("nan"), float("inf"), -float("inf")),
    *("", "first", "soon", "\x1b[2J", "\ud800", "../../x", "a" * 10_000, "0", "é"),
    *([], {}, [[]], [None], {"": 0}, [0] * 1000, {str(n): n for n in range(1000)}),
)
_DEPTH = 100_000


@dataclass(slots=True)
class Outcome:
    """Outcome of reading damaged files of one kind.

    Attributes:
        refused: number of files that raised stkzoo's own error.
        read: number of files that were read.
        findings: mutation and traceback of each other error.
    """

    refused: int = 0
    read: int = 0
    findings: list[str] = field(default_factory=list)


def mutate(value: Any, source: random.Random) -> Any:
    """Returns a copy of a JSON value with one or two random changes."""
    changed = {"root": copy.deepcopy(value)}
    for _ in range(source.choice((1, 1, 1, 2))):
        holder, key = source.choice(list(_places(changed)))
        _change(holder, key, source)
    return changed.get("root")


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yields each container in a value with each of its keys."""
    keys = list(value) if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def _change(holder: Any, key: Any, source: random.Random) -> None:
    present = holder[key]
    how = source.random()
    if how < 0.6:
        holder[key] = copy.deepcopy(source.choice(VALUES))
    elif how < 0.7 and isinstance(present, (int, float)):
        holder[key] = present * source.choice((-1, 2, 1000)) + source.choice((-1, 0, 1))
    elif how < 0.8 and key != "root":
        del holder[key]
    elif how < 0.9 and isinstance(present, list) and present:
        holder[key] = source.choice((present * 2, present[:-1], present[::-1], [present]))
    elif isinstance(holder, dict) and key != "root":
        holder[source.choice(("x", key.upper(), f"{key}\x00"))] = holder.pop(key)
    else:
        holder[key] = [present]


def damaged_text(text: str, source: random.Random) -> bytes:
    """Returns a damaged copy of a text, regardless of its structure."""
    data = text.encode("utf-8", "surrogatepass")
    place = source.randrange(len(data) + 1)
    return source.choice(
        (
            data[:place],
            data[:place] + bytes([source.randrange(256)]) + data[place + 1 :],
            data[:place] + data[place // 2 :],
            text.encode("utf-16"),
            b"\xef\xbb\xbf" + data,
            data[:place] + b"[" * _DEPTH,
            data[:place] + b'{"a":' * _DEPTH,
            data[:place] + b"9" * 10_000 + data[place:],
        )
    )


def run_kind(kind: FileKind, count: int, seed: int, folder: Path) -> Outcome:
    """Reads damaged files of a kind.

    Args:
        kind: the kind.
        count: number of files.
        seed: seed of the damage.
        folder: empty folder for the files.
    """
    source, outcome = random.Random(f"{seed} {kind.name}"), Outcome()
    kind.read(kind.write(folder, kind.valid()))  # a valid file must be readable
    for number in range(count):
        file = kind.damage(folder, source, mutate, damaged_text)
        try:
            kind.read(file)
            outcome.read += 1
        except StkzooError:
            outcome.refused += 1
        except Exception:  # noqa: BLE001 - any other error is a finding
            trace = traceback.format_exc()[-1500:]
            outcome.findings.append(f"{kind.name}, mutation {number}:\n{trace}")
    return outcome
