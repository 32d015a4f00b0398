"""Checks of infos, and of whose memory everything is."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np

from stkzoo.checks.play import (
    CheckFailed,
    EnvFactory,
    RandomPolicy,
    Step,
    expect,
    expect_equal,
    fingerprint,
    play,
    short_race,
    trace,
    whole_race,
)
from stkzoo.checks.spaces import arrays_in

_NUM_STEPS = 30


def check_infos_are_plain_numbers(make_env: EnvFactory) -> None:
    """Infos hold numbers under the same keys from reset on, for all agents, in fresh dicts.

    Raises:
        CheckFailed: they do not; the text names agent, step and key.
    """
    keys: list[Any] | None = None
    seen: list[Any] = []  # kept alive, so that no id comes twice by itself
    with closing(whole_race(make_env)()) as env:
        for step in play(env, 10):
            for agent, info in step.infos.items():
                where = f"step {step.number}: infos[{agent!r}]"
                expect(
                    not any(info is other for other in seen[-64:]),
                    f"{where} is a dict handed out before; expected a fresh one",
                )
                seen.append(info)
                keys = list(info) if keys is None else keys
                expect(
                    set(info) == set(keys),
                    f"{where} has the keys {sorted(map(str, info))}, expected those of the first "
                    f"info: {sorted(map(str, keys))}",
                )
                _check_numbers(info, where)


def check_results_share_no_memory(make_env: EnvFactory) -> None:
    """No two arrays share memory: of two agents, of two steps, of results and actions.

    Raises:
        CheckFailed: two do; the text names both.
    """
    found: list[tuple[str, np.ndarray[Any, Any]]] = []
    with closing(short_race(make_env)()) as env:
        for step in play(env, 11, max_steps=_NUM_STEPS):
            for name, part in {"actions": step.actions, **step.parts}.items():
                found.extend(arrays_in(part, f"step {step.number}: {name}"))
    for (path, array), (other_path, other) in _overlaps(found):
        raise CheckFailed(
            f"{path} {array.shape} shares memory with {other_path} {other.shape}; expected "
            "arrays of their own"
        )


def check_results_are_the_callers_own(make_env: EnvFactory) -> None:
    """Results stay as they are when the race goes on, and spoiling them spoils no race.

    The same is asked of actions: they are not changed, and may be changed afterwards.

    Raises:
        CheckFailed: something changed.
    """
    with closing(short_race(make_env)()) as env:
        expected = trace(play(env, 12, max_steps=_NUM_STEPS))
        last: Step | None = None
        content = ""
        for step in play(env, 12, max_steps=_NUM_STEPS, policy=_Watched(env)):
            expect(
                last is None or fingerprint(last.parts) == content,
                f"step {step.number} changed what step {step.number - 1} had returned; expected "
                "arrays that stay as they are",
            )
            last, content = step, fingerprint(step.parts)
        spoiled = trace(_spoiling(play(env, 12, max_steps=_NUM_STEPS)))
    expect_equal(expected, spoiled, "races with results left alone and overwritten by the caller")


class _Watched(RandomPolicy):
    """Notices when the last actions were changed by the environment."""

    _last: tuple[dict[Any, Any], dict[Any, Any]] | None = None

    def __call__(self, step: Step) -> dict[Any, Any]:
        expect(
            self._last is None or fingerprint(self._last[0]) == fingerprint(self._last[1]),
            f"step {step.number} changed the actions that were passed to it; expected them to be "
            "left alone",
        )
        actions = super().__call__(step)
        self._last = actions, copy.deepcopy(actions)
        return actions


def _check_numbers(info: Mapping[Any, Any], where: str) -> None:
    for key, value in info.items():
        is_number = isinstance(value, (bool, int, float, np.generic, np.ndarray))
        expect(
            is_number and np.asarray(value).dtype.kind in "biuf",
            f"{where}[{key!r}] is {value!r} of type {type(value).__name__}, expected a number; "
            "names belong elsewhere, since learners stack infos",
        )


def _spoiling(steps: Iterator[Step]) -> Iterator[Step]:
    """Passes steps on and, once they are recorded, overwrites all that they carry."""
    for step in steps:
        yield step
        for _, array in arrays_in([step.actions, step.parts], ""):
            if array.flags.writeable:
                array.fill(0 if array.dtype.kind in "US" else 77)
        for part in step.parts.values():
            for entry in part.values():
                if isinstance(entry, dict):
                    entry.clear()
            part.clear()


def _overlaps(arrays: list[tuple[str, np.ndarray[Any, Any]]]) -> Iterator[tuple[Any, Any]]:
    """Pairs of arrays that share memory, the later one first."""
    spans = sorted(
        (*np.lib.array_utils.byte_bounds(array), number)
        for number, (_, array) in enumerate(arrays)
        if array.size
    )
    active: list[tuple[int, int]] = []  # end and number of arrays that may still reach ahead
    for start, end, number in spans:
        active = [(other_end, other) for other_end, other in active if other_end > start]
        for _, other in active:
            if np.shares_memory(arrays[number][1], arrays[other][1]):
                yield arrays[max(number, other)], arrays[min(number, other)]
        active.append((end, number))
