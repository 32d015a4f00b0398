"""Several agents' race through Gymnasium's API, as a dictionary of agents."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gymnasium import spaces
from gymnasium.utils import EzPickle

from stkzoo.config import AgentSpec
from stkzoo.env.gymnasium_base import GymnasiumRaceEnv
from stkzoo.errors import ActionError, ApiOrderError


class STKRaceMultiEnv(GymnasiumRaceEnv):
    """A race of several agents, named ``"0"`` to ``"n-1"``, in the ``full`` view.

    The reward is the sum over the agents; ``info`` holds ``reward``, ``terminated``,
    ``done`` and ``infos`` by agent. The episode ends when all agents have finished; an
    agent that has finished is observed on, earns nothing more, and its actions are
    ignored.

    Args:
        agents: a list of :class:`~stkzoo.config.AgentSpec`, or how many; all karts by
            default.
        options: the keywords of :class:`~stkzoo.env.parallel.RaceParallelEnv`, except
            ``view``; ``max_cycles`` is unlimited by default.
    """

    def __init__(self, *, agents: Sequence[AgentSpec] | int | None = None, **options: Any) -> None:
        EzPickle.__init__(self, agents=agents, **options)
        super().__init__(agents, **options)
        self.agents = self.core.specs
        self._names = {str(i): agent for i, agent in enumerate(self.core.possible_agents)}
        self.observation_space = spaces.Dict(
            {key: self.core.observation_space(agent) for key, agent in self._names.items()}
        )
        self.action_space = spaces.Dict(
            {key: self.core.action_space(agent) for key, agent in self._names.items()}
        )

    @property
    def kart_indices(self) -> list[int] | None:
        """Index of every agent's kart in grid order; ``None`` before the first reset."""
        return list(self.core.race.kart_indices) if self.core.race else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts a race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`."""
        self._seed_core(seed)
        observations, infos = self.core.reset(options=options)
        self._recall(None)
        self._infos.update(infos)
        return (
            self._by_number({**self._observe_departed(observations), **observations}),
            self._info(dict.fromkeys(self.core.possible_agents, 0.0)),
        )

    def step(
        self, action: Mapping[str, Any]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advances the race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.step`."""
        if self.core.snapshot is not None and not self.core.agents:
            raise ApiOrderError("step() after the episode's end; call reset() first")
        try:
            actions = {self._names[key]: value for key, value in action.items()}
        except KeyError as error:
            key = str(error.args[0])
            raise ActionError(
                f"there is an action for agent {key!r}, expected {', '.join(self._names)}", key
            ) from None
        observations, rewards, terminations, truncations, infos = self.core.step(actions)
        self._terminated.update(terminations)
        self._truncated.update(truncations)
        self._infos.update(infos)
        return (
            self._by_number({**self._observe_departed(observations), **observations}),
            float(sum(rewards.values())),
            all(self._terminated.values()),
            any(truncations.values()),
            self._info({agent: rewards.get(agent, 0.0) for agent in self.core.possible_agents}),
        )

    def _front(self) -> Any:
        return dict(self._terminated), dict(self._truncated), dict(self._infos)

    def _recall(self, front: Any) -> None:
        agents = self.core.possible_agents
        self._terminated = {agent: agent not in self.core.agents for agent in agents}
        self._truncated = dict.fromkeys(agents, False)
        self._infos = self.core.infos(agents)
        if front is not None:
            self._terminated, self._truncated, self._infos = map(dict, front)

    def _observe_departed(self, present: Mapping[str, Any]) -> dict[str, Any]:
        departed = [agent for agent in self.core.possible_agents if agent not in present]
        return self.core.observe(departed) if departed else {}

    def _info(self, rewards: Mapping[str, float]) -> dict[str, Any]:
        done = {a: self._terminated[a] or self._truncated[a] for a in self._terminated}
        return {
            "infos": self._by_number({agent: dict(info) for agent, info in self._infos.items()}),
            "reward": self._by_number(rewards),
            "terminated": self._by_number(self._terminated),
            "done": self._by_number(done),
        }

    def _by_number(self, by_agent: Mapping[str, Any]) -> dict[str, Any]:
        return {key: by_agent[agent] for key, agent in self._names.items()}
