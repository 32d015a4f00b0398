"""Options of a race, validated before they reach the engine."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from stkzoo._checks import check_flag, check_number, check_type, check_whole, unknown_name
from stkzoo.config import NORMAL, AgentSpec, check_mode
from stkzoo.engine.setup import MAX_TEAMS
from stkzoo.env.starts import read_start
from stkzoo.errors import ConfigError
from stkzoo.names import CameraMode
from stkzoo.tracks import SPLITS

#: Longest step [s]; the game's physics becomes unreliable with coarser steps.
_MAX_STEP_SIZE = 1.0
#: Upper bound of counts; larger numbers overflow 32-bit fields.
_MAX_COUNT = 2**31 - 1
#: Bounds of integer options.
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
#: Options of an episode that may start in the middle of a race.
OF_AN_EPISODE = (*_OPTIONAL, *_SECONDS, "events")


@dataclass(frozen=True, slots=True, kw_only=True)
class RaceOptions:
    """Options of a race. ``reset(options=...)`` changes them for one episode.

    Attributes:
        num_kart: number of karts, agents and bots together.
        track: a track name, several names, ``None`` or ``"all"`` for any track, or ``"train"``,
            ``"train_only"``, ``"validation"`` or ``"test"`` for a track of that split
            (:mod:`stkzoo.tracks`).
        laps: number of laps.
        difficulty: skill of the game's bots and speed of all karts, 0 (lowest) to 3.
        reverse: drive the track in the opposite direction; ``None`` draws a direction at every
            reset.
        mode: ``"normal"``, or ``"time_trial"`` for the game's time trial: no item boxes,
            and each kart starts with one zipper per lap.
        max_paths: number of track segments ahead in observations; ``None`` for all.
        step_size: game time of one step [s].
        max_cycles: number of steps after which the race is truncated; ``None`` for no limit.
        start: where the karts start: ``None`` for the grid, a distance [m], a
            :class:`~stkzoo.config.Start`, a :class:`~stkzoo.config.RandomStart`, a mapping of the
            fields of either, ``"random"``, or a mapping from agents to these.
        events: whether infos count events such as contacts, hits and overtakes
            (:data:`stkzoo.mdp.events.EVENTS`).
        end_when_stuck: terminate an agent whose kart stays within 3 m for this long [s]; ``None``
            disables it, as for the other ``end_`` options.
        end_when_wrong_way: terminate an agent that drives in the wrong direction for this long [s].
        end_off_road: terminate an agent that is off the road for this long [s].
        end_when_first_finishes: number of steps after the first finish when the remaining agents
            are truncated; 0 truncates them in the step of the first finish.
    """

    num_kart: int = 3
    track: str | Sequence[str] | None = None
    laps: int = 1
    difficulty: int = 2
    reverse: bool | None = False
    mode: str = NORMAL
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
        check_mode(self.mode)
        check_type("events", self.events, bool, "True or False")
        check_type("reverse", self.reverse, bool | None, "True, False or None")
        for name in _SECONDS:
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), 0.0, unit="seconds")
        check_number("step_size", self.step_size, 1e-3, _MAX_STEP_SIZE)
        if isinstance(self.track, Sequence) and not isinstance(self.track, (str, bytes)):
            object.__setattr__(self, "track", tuple(self.track))
        else:
            check_type("track", self.track, str | None, "a name, names or None")

    def changed(self, options: Mapping[str, Any]) -> RaceOptions:
        """Returns a copy with the known entries of ``options`` applied.

        Raises:
            ConfigError: a value is invalid.
        """
        check_type("options", options, Mapping, "a dict from names of options to values")
        names = {field.name for field in fields(self)}
        return replace(self, **{name: value for name, value in options.items() if name in names})

    def of_episode(self, asked: Mapping[str, Any], known_tracks: Sequence[str]) -> RaceOptions:
        """Returns a copy with the options of a ``reset`` applied.

        Args:
            asked: the options; a ``state`` or ``scenario`` is not applied here.
            known_tracks: all tracks in the game's data.

        Raises:
            ConfigError: an option is unknown or invalid, or changes the number of karts.
        """
        options = self.changed(asked)
        if options.num_kart != self.num_kart:
            raise ConfigError(
                f"options request {options.num_kart} karts, but this environment has "
                f"{self.num_kart}; make another environment"
            )
        known = (*self.__dataclass_fields__, "state", "scenario")
        for name in asked:
            # PettingZoo's conformance tests reset with {"options": 1}.
            if name not in (*known, "options"):
                raise unknown_name("option", name, known)
        options.tracks(known_tracks)
        return options

    def tracks(self, known: Sequence[str]) -> tuple[str, ...]:
        """Returns the tracks from which an episode's track is drawn.

        Args:
            known: all tracks in the game's data.

        Raises:
            ConfigError: a requested track does not exist.
        """
        track = self.track
        if track is None or track == "all":
            return tuple(known)
        chosen = SPLITS.get(track, (track,)) if isinstance(track, str) else track
        if not chosen:
            raise ConfigError("track is an empty list, expected at least one name")
        for name in chosen:
            if name not in known:
                raise unknown_name("track", name, [*known, *SPLITS])
        return tuple(chosen)


def check_agents(agents: Sequence[AgentSpec], num_kart: int, karts: Sequence[str]) -> None:
    """Checks the agents' options.

    Args:
        agents: the agents.
        num_kart: number of karts in the race.
        karts: all kart models in the game's data.

    Raises:
        ConfigError: an option is invalid.
    """
    if not 1 <= len(agents) <= num_kart:
        raise ConfigError(
            f"{len(agents)} agents for {num_kart} karts: expected 1 to {num_kart} agents; "
            "raise num_kart or drop agents"
        )
    for index, agent in enumerate(agents):
        check_type(f"agent {index}", agent, AgentSpec, "an AgentSpec")
        check_flag(f"use_ai of agent {index}", agent.use_ai)
        if agent.rank_start is not None:
            check_whole(f"rank_start of agent {index}", agent.rank_start, 0, num_kart - 1)
        check_number(f"color of agent {index}", agent.color, 0.0, 1.0)
        if agent.kart and agent.kart not in karts:
            raise unknown_name("kart", agent.kart, karts)
        check_type(f"name of agent {index}", agent.name, str, "a string")
        if agent.team is not None:
            check_whole(f"team of agent {index}", agent.team, 0, MAX_TEAMS)
        camera_mode(agent)
    taken = [agent.rank_start for agent in agents if agent.rank_start is not None]
    for rank in taken:
        if taken.count(rank) > 1:
            raise ConfigError(f"several agents have rank_start={rank}, expected different places")


def use_known_karts(agents: Sequence[AgentSpec], karts: Sequence[str]) -> None:
    """Selects the game's default kart in place of unknown ones, with a warning for each.

    Args:
        agents: options of the agents; changed in place.
        karts: all kart models in the game's data.
    """
    for agent in agents:
        if agent.kart and isinstance(agent.kart, str) and agent.kart not in karts:
            problem = str(unknown_name("kart", agent.kart, karts)).partition(" Choose")[0]
            warnings.warn(f"{problem} The game's default kart races instead.", stacklevel=3)
            agent.kart = ""


def camera_mode(agent: AgentSpec) -> CameraMode:
    """Returns the agent's camera mode, given as an enum of stkzoo or pystk2, or by name."""
    mode: object = agent.camera_mode
    try:
        return CameraMode[mode.upper() if isinstance(mode, str) else getattr(mode, "name", "")]
    except KeyError:
        raise ConfigError(
            f"camera_mode is {agent.camera_mode!r}, expected one of "
            f"{', '.join(map(str, CameraMode.__members__))}"
        ) from None


def random_stream(seed: int | None) -> np.random.Generator:
    """Returns a new random generator, as ``reset(seed=...)`` makes it."""
    return seeding.np_random(None if seed is None else check_whole("seed", seed, 0))[0]
