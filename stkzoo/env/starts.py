"""Start positions other than the grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, TypeAlias

import numpy as np

from stkzoo.agent_names import by_agent
from stkzoo.config import RandomStart, Start, start_of
from stkzoo.errors import ConfigError

#: Maximum number of draws of a random start. A draw fails if some kart does not fit there. On the
#: worst track, two of three draws fail for eight karts, and training starts thousands of races.
MAX_START_DRAWS = 60

#: Distance between the rows of two in which karts start, as on the grid [m].
_ROW_LENGTH = 4.0
_COLUMN_OFFSET = 1.2

_EXPECTED = (
    "expected None for the grid, a distance [m], a Start, a RandomStart, 'random', or a mapping "
    "from agents to these"
)

#: Start positions: one for all karts, or one per agent; ``None`` is the grid.
StartChoice: TypeAlias = Start | RandomStart | Mapping[object, Start | RandomStart] | None


def read_start(start: object) -> StartChoice:
    """Reads the ``start`` option.

    Args:
        start: ``None`` for the grid, a distance [m], a start, ``"random"``, a mapping from agents
            to these, or the fields of a start as a mapping (:func:`stkzoo.config.start_of`).

    Raises:
        ConfigError: the option is invalid.
    """
    if start is None:
        return None
    if isinstance(start, Mapping):
        if not start:
            raise ConfigError(f"start is an empty mapping, {_EXPECTED}")
        if all(_names_agent(key) for key in start):
            return {agent: _read(choice) for agent, choice in start.items()}
    return _read(start)


def is_random(start: StartChoice) -> bool:
    """Whether another draw may give another position."""
    choices = start.values() if isinstance(start, Mapping) else [start]
    return any(isinstance(choice, RandomStart) for choice in choices)


def draw_starts(
    start: StartChoice,
    agents: Sequence[str],
    kart_indices: Sequence[int],
    num_kart: int,
    random: np.random.Generator,
) -> tuple[Start, ...]:
    """Returns the start of every kart, in grid order; empty for a start on the grid.

    A single start places the front row of the grid there and the other karts behind it. With a
    mapping, karts without an entry are placed behind the first agent in the mapping.

    Args:
        start: start from :func:`read_start`.
        agents: ids of the agents.
        kart_indices: karts of the agents, in grid order.
        num_kart: number of karts.
        random: random generator.
    """
    if start is None:
        return ()
    if not isinstance(start, Mapping):
        first = _drawn(start, random)
        return tuple(_in_row(first, place, num_kart) for place in range(num_kart))
    chosen = by_agent(start, agents)
    drawn = {agent: _drawn(chosen[agent], random) for agent in agents if agent in chosen}
    numbers = dict(zip(agents, kart_indices, strict=True))
    by_kart = {numbers[agent]: place for agent, place in drawn.items()}
    first = next(iter(drawn.values()))
    others = [kart for kart in range(num_kart) if kart not in by_kart]
    behind = {kart: _in_row(first, place + 2, num_kart) for place, kart in enumerate(others)}
    return tuple((by_kart | behind)[kart] for kart in range(num_kart))


def _names_agent(key: object) -> bool:
    """Whether a key of a mapping is an agent (id or number) rather than a field of a start."""
    return not isinstance(key, str) or key[-1:].isdecimal()


def _read(choice: object) -> Start | RandomStart:
    if isinstance(choice, (Start, RandomStart)):
        return choice
    if isinstance(choice, Mapping) and choice:
        return start_of(choice)
    if isinstance(choice, str) and choice == "random":
        return RandomStart()
    if isinstance(choice, (int, float, np.integer, np.floating)) and not isinstance(choice, bool):
        return Start(distance=float(choice))
    raise ConfigError(f"start is {choice!r}, {_EXPECTED}")


def _drawn(start: Start | RandomStart, random: np.random.Generator) -> Start:
    if isinstance(start, Start):
        return start
    bounds = {field.name: getattr(start, field.name) for field in fields(start)}
    drawn: dict[str, Any] = {
        name: float(low) if low == high else float(random.uniform(low, high))
        for name, (low, high) in bounds.items()
    }
    return Start(**drawn)


def _in_row(first: Start, place: int, num_kart: int) -> Start:
    """Returns the start a number of positions behind the first."""
    if num_kart == 1:
        return first
    side = _COLUMN_OFFSET if place % 2 else -_COLUMN_OFFSET
    return replace(
        first, offset=first.offset + side, behind=first.behind + place // 2 * _ROW_LENGTH
    )
