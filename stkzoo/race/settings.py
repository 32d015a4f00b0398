"""Settings of a race, which are also options of the ``stkzoo race`` command."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from msgspec import Meta

from stkzoo._arguments import option
from stkzoo._checks import check_arguments, check_name, check_number, check_type, check_whole
from stkzoo._schema import Level, Whole
from stkzoo.config import NORMAL, RACE_MODES, check_mode
from stkzoo.drivers.instances import DriverLimits
from stkzoo.drivers.sandbox import MODES
from stkzoo.errors import ConfigError

#: Ways to handle the failure of an agent, with their descriptions.
ERROR_HANDLING = {
    "raise": "end the race with the error",
    "catch": "use a random action for this step",
    "retire": "stop driving its kart; the others continue",
    "restart": "restart the agent during the race",
}

#: Titles of option groups.
_AGENTS, _END = "agents", "end of the race"


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class RaceSettings:
    """Settings of :func:`~stkzoo.race.run_race`. The attribute texts are also the options' help.

    ``None`` means no limit, or any track. Times are in seconds, memory is in MB. Without
    ``max_steps``, a race ends after the time that a kart needs at 4 m/s plus 60 s.

    Attributes:
        track: name of a track, or train, train_only, validation, test or all to draw one
            (default: all)
        laps: number of laps
        difficulty: skill of the game's AI and speed of all karts, 0 to 3
        reverse: drive in the other direction
        mode: normal, or the game's time trial, without item boxes and with one zipper per lap
        kart: kart model of all karts, as listed by `stkzoo karts` (default: the game's choice)
        seed: seed of all random numbers
        teams: karts of the same agent are a team, which they see in the view contest
        max_paths: track segments ahead that agents see (default: all)
        max_steps: end the race after N steps (0.1 s each; for `stkzoo play`, see --rate)
        max_steps_after_first: end the race N steps after the first kart finishes
        karts_finished: end the race when N karts have finished
        error_handling: what to do when an agent fails
        max_restarts: maximum number of restarts of an agent that fails
        action_timeout: time limit for an agent's decision; 0 for no limit
        start_timeout: time limit for loading an agent
        time_budget: retire an agent after this total time for decisions (default: no limit)
        agent_memory: memory limit of agents; 0 for no limit
        sandbox: sandbox for agents: on requires bubblewrap; auto uses the strongest available
        inline: run agents in this process: faster, but an agent can end the race
        show_output: show the output of agents on stderr
        adapter: Python file with create_actor(get_actor, module_dir, obs_space, act_space)
    """

    track: str | None = None
    laps: Annotated[int, Meta(ge=1, le=1000)] = 1
    difficulty: Level = 2
    reverse: bool = False
    mode: str = option(NORMAL, choices=RACE_MODES)
    kart: str | None = None
    seed: int = 0
    teams: bool = False
    max_paths: Whole | None = None
    max_steps: int | None = option(group=_END)
    max_steps_after_first: int | None = option(group=_END)
    karts_finished: int | None = option(group=_END)
    error_handling: str = option("retire", choices=tuple(ERROR_HANDLING), group=_AGENTS)
    max_restarts: int = option(3, group=_AGENTS)
    action_timeout: float | None = option(10.0, metavar="SECONDS", group=_AGENTS)
    start_timeout: float = option(60.0, metavar="SECONDS", group=_AGENTS)
    time_budget: float | None = option(metavar="SECONDS", group=_AGENTS)
    agent_memory: int | None = option(4096, metavar="MB", group=_AGENTS)
    sandbox: str = option("auto", choices=MODES, group=_AGENTS)
    inline: bool = option(False, group=_AGENTS)
    show_output: bool = option(False, group=_AGENTS)
    adapter: str | None = option(metavar="FILE", group=_AGENTS)

    def __post_init__(self) -> None:
        check_mode(self.mode)
        check_whole("seed", self.seed, 0)
        check_whole("max_restarts", self.max_restarts, 0)
        check_type("adapter", self.adapter, str | os.PathLike | None, "the path of a Python file")
        for name in ("action_timeout", "time_budget", "agent_memory"):
            value = getattr(self, name)
            if isinstance(value, (int, float)) and value == 0:
                object.__setattr__(self, name, None)
        for name in ("max_steps", "max_steps_after_first", "karts_finished", "agent_memory"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 1)
        check_number("start_timeout", self.start_timeout, unit="seconds")
        for name in ("action_timeout", "time_budget"):
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), unit="seconds")
        check_name("sandbox", self.sandbox, MODES)
        check_name("error_handling", self.error_handling, ERROR_HANDLING)
        if self.sandbox == "on" and self.inline:
            raise ConfigError("sandbox is 'on', but agents run inline; leave out one of the two")

    @classmethod
    def changed(
        cls,
        settings: RaceSettings | None,
        changes: Mapping[str, Any],
        decided: Collection[str] = (),
    ) -> RaceSettings:
        """Returns settings with some fields replaced.

        Args:
            settings: the original settings; ``None`` for the defaults.
            changes: fields that replace those of ``settings``.
            decided: names of fields that ``changes`` must not contain.

        Raises:
            ConfigError: a name in ``changes`` is unknown or decided, or a value is invalid.
        """
        known = [entry.name for entry in fields(cls) if entry.name not in decided]
        for name in changes:
            check_name("setting of a race", name, known)
        check_type("settings", settings, RaceSettings | None, "RaceSettings")
        return replace(settings or cls(), **changes)

    @property
    def limits(self) -> DriverLimits:
        """Resource limits of each driver."""
        return DriverLimits(
            self.action_timeout, self.start_timeout, self.agent_memory, self.sandbox
        )
