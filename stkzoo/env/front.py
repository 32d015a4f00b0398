"""What all environments of one race have in common, whatever library they are for."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils import EzPickle

from stkzoo._checks import check_type
from stkzoo.engine.ground import Ground
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.env.grid import RaceInfo
from stkzoo.env.options import RaceOptions
from stkzoo.env.race import Race
from stkzoo.env.rendering import scene_of
from stkzoo.env.scenario import Scenario
from stkzoo.env.state import RaceState
from stkzoo.render.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self


class RaceOption:
    """An option of later races, as an attribute that you may set between races."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        return self if instance is None else getattr(instance.options, self._name)

    def __set__(self, instance: Any, value: object) -> None:
        instance.options = replace(instance.options, **{self._name: value})


class RaceFront(EzPickle):
    """An environment that drives one race.

    A copy, by pickle too, is made from the constructor's arguments and the options of the next
    race; it starts a race of its own at its next ``reset``. Only :meth:`clone` copies a race.

    Attributes:
        live_race: the race.
        max_cycles: number of steps after which the race is truncated; ``None`` for no limit.
    """

    live_race: Race
    max_cycles = RaceOption("max_cycles")

    def render(self) -> Any:
        """Renders the race according to ``render_mode``.

        Returns:
            With ``"rgb_array"``, a frame ``(height, width, 3)`` uint8: the view of the first
                agent's camera, several cameras as tiles, or the map. With ``"human"``, ``None``:
                the window updates after every step.

        Raises:
            ApiOrderError: called before the first ``reset``.
            EngineError: the game cannot render on this machine and ``render_backend`` is
                ``"engine"``.
        """
        return self.live_race.rendering.render(self.live_race.episode)

    def close(self) -> None:
        """Stops the game process. You may call ``reset`` again."""
        with self.live_race.turn:
            self.live_race.close()

    @property
    def options(self) -> RaceOptions:
        """Options of the next race."""
        return self.live_race.options

    @options.setter
    def options(self, options: RaceOptions) -> None:
        self.live_race.options = check_type("options", options, RaceOptions, "RaceOptions")

    @property
    def np_random(self) -> np.random.Generator:
        """The environment's random generator, which ``reset(seed=...)`` seeds."""
        return self.live_race.np_random

    @np_random.setter
    def np_random(self, random: np.random.Generator) -> None:
        self.live_race.np_random = random

    @property
    def race(self) -> RaceInfo | None:
        """Names of the current race and its karts; ``None`` before the first reset."""
        return episode.race if (episode := self.live_race.episode) else None

    @property
    def scene(self) -> Scene | None:
        """Data of the current race for rendering; ``None`` before the first reset."""
        return scene_of(episode) if (episode := self.live_race.episode) else None

    @property
    def track_map(self) -> TrackMap | None:
        """Map of the current track; ``None`` before the first reset."""
        return episode.track_map if (episode := self.live_race.episode) else None

    @property
    def ground(self) -> Ground | None:
        """Ground and walls of the current track; ``None`` before the first reset.

        They are read from the track's meshes, which takes 0.2 to 2 s the first time.
        """
        return episode.ground if (episode := self.live_race.episode) else None

    @property
    def snapshot(self) -> Snapshot | None:
        """Snapshot of all karts at the current moment; ``None`` before the first reset."""
        return episode.snapshot if (episode := self.live_race.episode) else None

    @property
    def render_backend(self) -> str:
        """Renderer in use: ``"engine"`` or ``"map"``; ``"auto"`` before the first frame."""
        return self.live_race.rendering.backend

    # ------------------------------------------------------------------ saved moments

    def save_state(self) -> RaceState:
        """Saves the current moment of the race, which continues unaffected.

        Raises:
            ApiOrderError: called before the first ``reset``.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        with self.live_race.turn:
            return self.live_race.save()

    def restore_state(self, state: RaceState) -> None:
        """Continues from a saved state, with everything as it was at that moment.

        This includes the counters of the episode, the reward of the environment that saved the
        state, the state of wrappers, and the random generator, so later resets repeat too. The race
        that was running in this environment ends.

        Args:
            state: a state of this environment, or of another one with the same karts, agents and
                opponents.

        Raises:
            ApiOrderError: the state was closed.
            ConfigError: the state belongs to an environment with other karts or agents.
            EngineError: this platform cannot fork races, or the state's process has ended; this
                environment's race continues.
        """
        with self.live_race.turn:
            self.live_race.restore(state)

    def follow(self, other: Self) -> None:
        """Continues from the current state of another environment, like a clone of it.

        Args:
            other: an environment with the same karts, agents and opponents.

        Raises:
            ApiOrderError: the other environment was not reset yet.
            ConfigError: the other one is no environment of one race, or has other karts or agents.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        check_type("other", other, RaceFront, "an environment of one race")
        with self.live_race.turn, other.live_race.turn:
            self.live_race.follow(other.live_race)

    def scenario(self) -> Scenario:
        """Returns the current moment as a scenario, which can be saved and replayed elsewhere.

        Raises:
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        return self.live_race.scenario()

    def clone(self) -> Self:
        """Returns an independent environment that continues from this moment.

        Raises:
            ApiOrderError: called before the first ``reset``.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        make: Any = type(self)
        twin: Self = make(*self._ezpickle_args, **self._ezpickle_kwargs)
        twin.follow(self)
        return twin

    def lookahead(self) -> contextlib.closing[Self]:
        """Yields a clone for trying actions and closes it at the end.

        Raises:
            ApiOrderError: called before the first ``reset``.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        return contextlib.closing(self.clone())

    def __getstate__(self) -> dict[str, Any]:
        """Returns the arguments and the options of the next race."""
        return {**super().__getstate__(), "options": self.options}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment in place, because its cameras refer to it."""
        self.__init__(*state["_ezpickle_args"], **state["_ezpickle_kwargs"])  # type: ignore[misc]
        self.options = state["options"]
        self.live_race.is_copy = True
