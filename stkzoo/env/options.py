"""What can be chosen about a race, checked before the engine sees any of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from stkzoo.config import AgentSpec
from stkzoo.env.starts import read_start
from stkzoo.errors import ConfigError, check_number, check_whole, unknown_name
from stkzoo.names import CameraMode
from stkzoo.tracks import SPLITS

#: The game's physics takes coarser steps badly, and a race has no use for them.
_MAX_STEP_SIZE = 1.0
#: More paths or steps than any race has; larger numbers do not fit everywhere.
_MAX_COUNT = 2**31 - 1
#: Bounds of whole numbers.
_WHOLE = {
    "num_kart": (1, 256),
    "laps": (1, 1000),
    "difficulty": (0, 3),
    "max_paths": (1, _MAX_COUNT),
    "max_cycles": (1, _MAX_COUNT),
    "end_when_first_finishes": (0, _MAX_COUNT),
}
_OPTIONAL = ("max_paths", "max_cycles", "end_when_first_finishes")
_SECONDS = ("end_when_stuck", "end_when_wrong_way", "end_off_road")
#: Options that count from an episode's first moment, wherever in a race that is.
OF_AN_EPISODE = (*_OPTIONAL, *_SECONDS, "events")
#: As many views as the game's window can be split into.
MAX_CAMERAS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class RaceOptions:
    """The options of a race. ``reset(options=...)`` may change those of one episode.

    Attributes:
        num_kart: number of karts, agents and bots together.
        track: a name, several names, ``None`` or ``"all"`` for any track, ``"train"`` or
            ``"test"`` for one of a split (:mod:`stkzoo.tracks`).
        laps: number of laps.
        difficulty: how well the game's bots drive, 0 to 3.
        reverse: drive the track the other way round.
        max_paths: how many track segments ahead are observed; ``None`` is all.
        step_size: game time of one step [s].
        max_cycles: steps after which the race is cut short; ``None`` is never.
        start: where the karts start: ``None`` on the grid, a distance [m], a
            :class:`~stkzoo.config.Start`, a :class:`~stkzoo.config.RandomStart` or a mapping of
            the fields of one, ``"random"``, or a mapping from agents to these.
        events: whether infos count contacts, hits, overtakes and so on
            (:data:`stkzoo.mdp.events.EVENTS`).
        end_when_stuck: terminates an agent whose kart stays within 3 m for so long [s]; ``None``
            is never, as for the others.
        end_when_wrong_way: the same for driving against the road's direction [s].
        end_off_road: the same for being off the road [s].
        end_when_first_finishes: steps after which those who still race are truncated, from the
            step in which the first kart finishes on; 0 is at once.
    """

    num_kart: int = 3
    track: str | Sequence[str] | None = None
    laps: int = 1
    difficulty: int = 2
    reverse: bool = False
    max_paths: int | None = None
    step_size: float = 0.1
    max_cycles: int | None = 1500
    start: Any = None
    events: bool = False
    end_when_stuck: float | None = None
    end_when_wrong_way: float | None = None
    end_off_road: float | None = None
    end_when_first_finishes: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", read_start(self.start))
        for name, (low, high) in _WHOLE.items():
            value = getattr(self, name)
            if value is not None or name not in _OPTIONAL:
                object.__setattr__(self, name, check_whole(name, value, low, high))
        for name in ("reverse", "events"):
            if not isinstance(getattr(self, name), bool):
                raise ConfigError(f"{name} is {getattr(self, name)!r}, expected True or False")
        for name in _SECONDS:
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), 0.0, unit="seconds")
        check_number("step_size", self.step_size, 1e-3, _MAX_STEP_SIZE)
        if isinstance(self.track, Sequence) and not isinstance(self.track, str):
            object.__setattr__(self, "track", tuple(self.track))
        elif not isinstance(self.track, (str, type(None))):
            raise ConfigError(f"track is {self.track!r}, expected a name, names or None")

    def changed(self, options: Mapping[str, Any]) -> RaceOptions:
        """These options with those of ``options`` that are known."""
        if not isinstance(options, Mapping):
            raise ConfigError(
                f"options is {options!r}, expected a dict from names of options to values"
            )
        names = {field.name for field in fields(self)}
        return replace(self, **{name: value for name, value in options.items() if name in names})

    def tracks(self, known: Sequence[str]) -> tuple[str, ...]:
        """The tracks that an episode may take place on.

        Args:
            known: all tracks of the game's data.

        Raises:
            ConfigError: a track is not among them.
        """
        if self.track is None or self.track == "all":
            return tuple(known)
        if isinstance(self.track, str):
            chosen: Sequence[str] = SPLITS.get(self.track, (self.track,))
        else:
            chosen = self.track
        if not chosen:
            raise ConfigError("track is an empty list, expected at least one name")
        for name in chosen:
            if name not in known:
                raise unknown_name("track", name, [*known, *SPLITS])
        return tuple(chosen)


def check_agents(agents: Sequence[AgentSpec], num_kart: int, karts: Sequence[str]) -> None:
    """Checks what the agents ask for.

    Args:
        agents: the agents.
        num_kart: number of karts in the race.
        karts: all kart models of the game's data.

    Raises:
        ConfigError: an option is invalid.
    """
    if not 1 <= len(agents) <= num_kart:
        raise ConfigError(
            f"{len(agents)} agents for {num_kart} karts: expected 1 to {num_kart} agents; "
            "raise num_kart or drop agents"
        )
    for index, agent in enumerate(agents):
        if not isinstance(agent, AgentSpec):
            raise ConfigError(f"agent {index} is {agent!r}, expected an AgentSpec")
        if not isinstance(agent.use_ai, (bool, int, np.bool_)):
            raise ConfigError(
                f"use_ai of agent {index} is {agent.use_ai!r}, expected True or False"
            )
        if agent.rank_start is not None:
            check_whole(f"rank_start of agent {index}", agent.rank_start, 0, num_kart - 1)
        check_number(f"color of agent {index}", agent.color, 0.0, 1.0)
        if not isinstance(agent.kart, str) or (agent.kart and agent.kart not in karts):
            raise unknown_name("kart", agent.kart, karts)
        if not isinstance(agent.name, str):
            raise ConfigError(f"name of agent {index} is {agent.name!r}, expected a string")
        camera_mode(agent)
    taken = [agent.rank_start for agent in agents if agent.rank_start is not None]
    for rank in taken:
        if taken.count(rank) > 1:
            raise ConfigError(f"several agents have rank_start={rank}, expected different places")


def camera_mode(agent: AgentSpec) -> CameraMode:
    """The agent's camera mode, also when it is given as pystk2's own kind or by name."""
    mode: object = agent.camera_mode
    try:
        return CameraMode[mode.upper() if isinstance(mode, str) else getattr(mode, "name", "")]
    except KeyError:
        raise ConfigError(
            f"camera_mode is {agent.camera_mode!r}, expected one of "
            f"{', '.join(map(str, CameraMode.__members__))}"
        ) from None


def random_stream(seed: int | None) -> np.random.Generator:
    """A random stream, as ``reset(seed=...)`` begins it."""
    return seeding.np_random(None if seed is None else check_whole("seed", seed, 0))[0]
