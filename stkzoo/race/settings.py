"""What can be chosen about a race that is run to its end; the command's flags come from here."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import Any

from stkzoo.errors import ConfigError, check_number, check_whole
from stkzoo.race.instances import DriverLimits

#: What to do when an agent fails.
ERROR_HANDLING = {
    "raise": "end the race with the error",
    "catch": "take a random action instead, and ask it again at the next step",
    "retire": "let its kart roll to a stop; the others continue",
    "restart": "start it again, in the middle of the race",
}


def _option(default: Any, text: str, **more: Any) -> Any:
    return field(default=default, metadata={"help": text, **more})


@dataclass(frozen=True, slots=True, kw_only=True)
class RaceSettings:
    """The settings of :func:`~stkzoo.race.run_race`.

    Attributes:
        track: a track's name; ``"train"``, ``"test"``, ``"all"`` or ``None`` (as ``"all"``) for a
            random one.
        laps: number of laps.
        difficulty: level of the game's AI, 0 to 3.
        reverse: drive the track in the other direction.
        seed: seed of all random numbers.
        max_paths: track segments ahead in observations; ``None`` for all.
        max_steps: the race ends after this number of steps. By default it ends after the time
            that a kart needs at 4 m/s, plus a minute.
        max_steps_after_first: it ends this number of steps after the first kart finished.
        karts_finished: it ends when this number of karts have finished.
        error_handling: what to do when an agent fails: one of :data:`ERROR_HANDLING`.
        max_restarts: restarts of each agent in one race.
        action_timeout: time limit for one decision [s]; ``None`` for no limit.
        start_timeout: time limit for loading an agent [s].
        agent_memory: memory limit of an agent's process [MB]; ``None`` for no limit.
        inline: run agents from files in this process: faster, but without protection.
        adapter: Python file that makes the actors of agents from files.
    """

    track: str | None = _option(None, "a track's name, or train, test or all to draw one")
    laps: int = _option(1, "number of laps")
    difficulty: int = _option(2, "of the game's AI, 0 to 3")
    reverse: bool = _option(False, "drive in the other direction")
    seed: int = _option(0, "seed of all random numbers")
    max_paths: int | None = _option(None, "track segments ahead that agents see (default: all)")
    max_steps: int | None = _option(None, "end the race after this number of steps")
    max_steps_after_first: int | None = _option(
        None, "end the race this number of steps after the first kart finished"
    )
    karts_finished: int | None = _option(None, "end the race when this number of karts finished")
    error_handling: str = _option("retire", "when an agent fails", choices=tuple(ERROR_HANDLING))
    max_restarts: int = _option(3, "restarts of a failed agent")
    action_timeout: float | None = _option(
        10.0, "time limit for an agent's decision; 0 for no limit", metavar="SECONDS"
    )
    start_timeout: float = _option(60.0, "time limit for loading an agent", metavar="SECONDS")
    agent_memory: int | None = _option(4096, "memory limit of agents; 0 for no limit", metavar="MB")
    inline: bool = _option(False, "run agents in this process: faster, but without protection")
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
            check_number("action_timeout", self.action_timeout, unit="seconds")
        check_number("start_timeout", self.start_timeout, unit="seconds")
        if self.agent_memory is not None:
            check_whole("agent_memory", self.agent_memory, 1)
        if not isinstance(self.error_handling, str) or self.error_handling not in ERROR_HANDLING:
            raise ConfigError(
                f"error_handling is {self.error_handling!r}, expected one of "
                f"{', '.join(ERROR_HANDLING)}"
            )

    @property
    def limits(self) -> DriverLimits:
        """The resources that each driver may use."""
        return DriverLimits(self.action_timeout, self.start_timeout, self.agent_memory)
