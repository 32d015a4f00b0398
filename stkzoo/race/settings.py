"""What can be chosen about a race that is run to its end; the command's flags come from here."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from typing import Any

from stkzoo.errors import ConfigError, check_whole
from stkzoo.race.instances import DriverLimits

__all__ = ["ERROR_HANDLING", "RaceSettings"]

#: What to do when an agent fails.
ERROR_HANDLING = {
    "raise": "end the race with the error",
    "catch": "do something at random in its place, and ask it again at the next step",
    "retire": "let its kart roll to a stop; the others race on",
    "restart": "start it anew, in the middle of the race",
}


def _option(default: Any, text: str, **more: Any) -> Any:
    return field(default=default, metadata={"help": text, **more})


@dataclass(frozen=True, slots=True, kw_only=True)
class RaceSettings:
    """The settings of :func:`~stkzoo.race.run_race`.

    Attributes:
        track: a track's name; ``"train"``, ``"test"`` or ``"all"`` draw one of these, as
            ``None`` does of all.
        laps: number of laps.
        difficulty: level of the game's AI, 0 to 3.
        reverse: drive the track the other way round.
        seed: decides all that is left to chance.
        max_paths: how many track segments ahead are observed; ``None`` is all.
        max_steps: the race is over after so many steps. By default it is over when a kart
            could have done the whole way at 4 m/s and a minute more has passed.
        max_steps_after_first: it is over so many steps after the first kart has finished.
        karts_finished: it is over when so many karts have finished.
        error_handling: what to do when an agent fails: one of :data:`ERROR_HANDLING`.
        max_restarts: how often an agent's process may be started again in one race.
        action_timeout: how long an agent may think about one step [s]; ``None`` is no limit.
        start_timeout: how long it may take to load [s].
        agent_memory: how much its process may use [MB]; ``None`` is no limit.
        inline: run agents from files in this process: quicker, but not safe.
        adapter: Python file that makes the actors of agents from files.
    """

    track: str | None = _option(None, "a track's name, or train, test or all to draw one")
    laps: int = _option(1, "number of laps")
    difficulty: int = _option(2, "of the game's AI, 0 to 3")
    reverse: bool = _option(False, "drive the other way round")
    seed: int = _option(0, "decides all that is left to chance")
    max_paths: int | None = _option(None, "track segments ahead that agents see (default: all)")
    max_steps: int | None = _option(None, "the race is over after so many steps")
    max_steps_after_first: int | None = _option(
        None, "the race is over so many steps after the first has finished"
    )
    karts_finished: int | None = _option(None, "the race is over when so many have finished")
    error_handling: str = _option("retire", "when an agent fails", choices=tuple(ERROR_HANDLING))
    max_restarts: int = _option(3, "how often a failed agent may be started again")
    action_timeout: float | None = _option(
        10.0, "seconds an agent may think about a step; 0 is no limit", metavar="SECONDS"
    )
    start_timeout: float = _option(60.0, "seconds an agent may take to load", metavar="SECONDS")
    agent_memory: int | None = _option(4096, "memory an agent may use; 0 is no limit", metavar="MB")
    inline: bool = _option(False, "run agents in this process: quicker, but not safe")
    adapter: str | None = _option(
        None, "Python file with create_actor(get_actor, module_dir, obs_space, act_space)"
    )

    def __post_init__(self) -> None:
        check_whole("seed", self.seed, 0)
        check_whole("max_restarts", self.max_restarts, 0)
        if self.adapter is not None and not isinstance(self.adapter, (str, os.PathLike)):
            raise ConfigError(f"adapter is {self.adapter!r}, expected the path of a Python file")
        for name in ("max_steps", "max_steps_after_first", "karts_finished"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 1)
        for name in ("action_timeout", "agent_memory"):
            value = getattr(self, name)
            if isinstance(value, (int, float)) and value == 0:
                object.__setattr__(self, name, None)
        if self.action_timeout is not None:
            _check_seconds("action_timeout", self.action_timeout)
        _check_seconds("start_timeout", self.start_timeout)
        if self.agent_memory is not None:
            check_whole("agent_memory", self.agent_memory, 1)
        if not isinstance(self.error_handling, str) or self.error_handling not in ERROR_HANDLING:
            raise ConfigError(
                f"error_handling is {self.error_handling!r}, expected one of "
                f"{', '.join(ERROR_HANDLING)}"
            )

    @property
    def limits(self) -> DriverLimits:
        """What each driver may use."""
        return DriverLimits(self.action_timeout, self.start_timeout, self.agent_memory)


def _check_seconds(name: str, value: object) -> None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not 0 < value < math.inf:  # type: ignore[operator]
        raise ConfigError(f"{name} is {value!r}, expected a number of seconds above 0")
