"""Races as fingerprints, so that whole races can be compared bit by bit."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from stkzoo.checks.failure import CheckFailed
from stkzoo.checks.play import Step

__all__ = ["Trace", "check_equal", "fingerprint", "first_difference", "trace"]

#: For each step, a fingerprint of every value that came out, by the value's path.
Trace: TypeAlias = list[dict[str, str]]


def trace(steps: Iterable[Step]) -> Trace:
    """The fingerprints of a race, whose steps may be generated on the way."""
    return [dict(_fingerprints_of_step(step)) for step in steps]


def fingerprint(value: Any) -> str:
    """A hash of a value's types and bits, through dicts, tuples and lists, 16 hex digits."""
    digest = hashlib.blake2b(digest_size=8)
    _update(digest, value)
    return digest.hexdigest()


def first_difference(expected: Trace, actual: Trace) -> str | None:
    """Where two races part first, in words; ``None`` if they are equal."""
    for number, (left, right) in enumerate(zip(expected, actual, strict=False)):
        for path in left | right:
            if left.get(path) != right.get(path):
                return f"first at step {number} in {path}"
    if len(expected) != len(actual):
        return f"one ends at step {len(expected) - 1}, the other at step {len(actual) - 1}"
    return None


def check_equal(expected: Trace, actual: Trace, what: str) -> None:
    """Compares two races that should be one and the same.

    Args:
        expected: one race.
        actual: the other.
        what: what the two are, as the subject of a sentence.

    Raises:
        CheckFailed: they differ.
    """
    difference = first_difference(expected, actual)
    if difference is not None:
        raise CheckFailed(f"{what} differ, {difference}; expected the same bits")


def _fingerprints_of_step(step: Step) -> Iterator[tuple[str, str]]:
    yield "agents", fingerprint(step.agents)
    for name, part in step.parts.items():
        yield from _fingerprints(name, part)


def _fingerprints(path: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        yield f"the keys of {path}", fingerprint(sorted(map(repr, value)))
        for key, entry in value.items():
            yield from _fingerprints(f"{path}[{key!r}]", entry)
    else:
        yield path, fingerprint(value)


def _update(digest: Any, value: Any) -> None:
    if isinstance(value, (np.ndarray, np.generic)):
        kind = type(value).__name__
        digest.update(f"{kind} {value.dtype.str} {value.shape} ".encode() + value.tobytes())
    elif isinstance(value, Mapping):
        digest.update(f"dict {len(value)} ".encode())
        for key, entry in value.items():
            _update(digest, key)
            _update(digest, entry)
    elif isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        digest.update(f"{type(value).__name__} {len(value)} ".encode())
        _update_all(digest, value)
    else:
        digest.update(f"{type(value).__name__} {value!r} ".encode())


def _update_all(digest: Any, values: Sequence[Any]) -> None:
    forms = {(value.dtype, value.shape) for value in values if type(value) is np.ndarray}
    if len(forms) == 1 and all(type(value) is np.ndarray for value in values):
        ((dtype, shape),) = forms  # long lists of like arrays, at once
        digest.update(f"each {dtype.str} {shape} ".encode())
        digest.update(b"".join([value.tobytes() for value in values]))
    else:
        for value in values:
            _update(digest, value)
