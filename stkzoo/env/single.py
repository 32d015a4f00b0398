"""One agent's race through Gymnasium's API."""

from __future__ import annotations

from typing import Any

from gymnasium.utils import EzPickle

from stkzoo.config import AgentSpec
from stkzoo.env.gymnasium_base import GymnasiumRaceEnv
from stkzoo.env.keyboard import keys_to_action
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.views import views_of_agents
from stkzoo.wrappers.camera import Camera


class STKRaceEnv(GymnasiumRaceEnv):
    """A race in which one kart is yours and the game drives the others.

    Args:
        agent: your kart's :class:`~stkzoo.config.AgentSpec`.
        options: the keywords of :class:`~stkzoo.env.parallel.RaceParallelEnv`, except
            ``agents``; ``max_cycles`` is unlimited by default.
    """

    def __init__(self, *, agent: AgentSpec | None = None, **options: Any) -> None:
        EzPickle.__init__(self, agent=agent, **options)
        if agent is not None and not isinstance(agent, AgentSpec):
            raise ConfigError(f"agent is {agent!r}, expected an AgentSpec or None")
        self.agent = agent if agent is not None else AgentSpec()
        super().__init__([self.agent], **options)
        (self._name,) = self.core.possible_agents
        self.observation_space = self.core.observation_space(self._name)
        self.action_space = self.core.action_space(self._name)

    @property
    def kart_ix(self) -> int | None:
        """Index of your kart in grid order; ``None`` before the first reset."""
        return self.core.race.kart_indices[0] if self.core.race else None

    @property
    def camera(self) -> Camera:
        """Your kart's camera, for :class:`~stkzoo.wrappers.CameraObservations`."""
        return self.core.cameras.of(self._name)

    def get_keys_to_action(self) -> dict[Any, Any]:
        """What each combination of keys does, for :func:`gymnasium.utils.play.play`.

        The keys are the game's: arrows, space fires, N is nitro, V drifts, backspace calls
        the rescue bird.

        Raises:
            ConfigError: for a view of your own that cannot say what a key means in it.
        """
        view = self._ezpickle_kwargs.get("view", "full")
        return keys_to_action(views_of_agents(view, [self._name])[self._name], repr(view))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts a race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`."""
        self._seed_core(seed)
        observations, infos = self.core.reset(options=options)
        return observations[self._name], infos[self._name]

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Advances the race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.step`."""
        if self.core.snapshot is not None and not self.core.agents:
            raise ApiOrderError("step() after the episode's end; call reset() first")
        observations, rewards, terminations, truncations, infos = self.core.step(
            {self._name: action}
        )
        name = self._name
        return observations[name], rewards[name], terminations[name], truncations[name], infos[name]
