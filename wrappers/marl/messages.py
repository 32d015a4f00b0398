"""Messages between agents: a channel around an environment."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo._checks import check_number, check_whole, shortened
from stkzoo.agent_names import actions_by_agent, of_agent
from stkzoo.errors import ActionError, ConfigError
from stkzoo.views.actions import read_action
from stkzoo.views.walker import StepParts
from stkzoo.wrappers.marl.teams import ClonableWrapper, Teams

#: One message, ``(size,)``.
Message = npt.NDArray[np.float32]


class MessageChannel(ClonableWrapper):
    """Lets each agent send one message per step, which others receive one step later.

    Actions become dicts of ``action``, the original action, and ``message``. Observations become
    dicts of ``observation``, the original observation; ``messages``, ``(agents - 1, size)``
    float32, the messages of the other agents in agent order; and ``heard``, ``(agents - 1,)`` int8,
    1 for agents whose message arrived. Agents that are out of reach, in another team or no longer
    racing are not heard: their rows are zeros. Nothing is heard in the first observation. Agents
    that are truncated are heard once more, in the last observations.

    Args:
        env: a race (``race_v0.parallel_env``), perhaps wrapped.
        size: length of a message; its values are in [-1, 1].
        words: send one of this many words instead: ``Discrete(words)`` as the message, received as
            a one-hot vector of ``size = words``.
        reach: largest distance of a receiver [m]; ``None`` for no limit.
        within_teams: whether only teammates receive messages; ``env`` must contain :class:`Teams`.

    Raises:
        ConfigError: an argument is invalid.
    """

    def __init__(
        self,
        env: ParallelEnv[str, Any, Any],
        *,
        size: int = 4,
        words: int | None = None,
        reach: float = math.inf,
        within_teams: bool = False,
    ) -> None:
        super().__init__(env)
        self.words = None if words is None else check_whole("words", words, 2)
        self.size = self.words or check_whole("size", size, 1)
        self.reach = check_number("reach", reach, unit="meters", is_finite=False)
        self._message_space: spaces.Space[Any] = (
            spaces.Discrete(self.words) if self.words else spaces.Box(-1, 1, (self.size,))
        )
        self._team_of = _teams_in(env) if within_teams else dict.fromkeys(env.possible_agents, 0)
        self._said: dict[str, Message] = {}
        self._observation_spaces: dict[str, spaces.Space[Any]] = {}
        self._action_spaces: dict[str, spaces.Space[Any]] = {}
        others = len(env.possible_agents) - 1
        messages = spaces.Box(-1, 1, (others, self.size))
        heard = spaces.Box(0, 1, (others,), np.int8)
        for agent in env.possible_agents:
            seen = {"observation": env.observation_space(agent), "messages": messages}
            done = {"action": env.action_space(agent), "message": self._message_space}
            self._observation_spaces[agent] = copy.deepcopy(spaces.Dict(seen | {"heard": heard}))
            self._action_spaces[agent] = copy.deepcopy(spaces.Dict(done))

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space, the same object on every call."""
        return of_agent(self._observation_spaces, agent)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's action space, the same object on every call."""
        return of_agent(self._action_spaces, agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the race and clears all messages."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._said = {}
        return self._with_messages(observations), infos

    def step(self, actions: dict[str, Any]) -> StepParts:
        """Steps the race and delivers the messages.

        Raises:
            ActionError: a message is missing or invalid; the race has not advanced.
        """
        actions = actions_by_agent(actions, self.env.agents)
        said = {agent: self._message(agent, action) for agent, action in actions.items()}
        bare = {agent: action["action"] for agent, action in actions.items()}
        observations, rewards, terminations, truncations, infos = self.env.step(bare)
        # For agents that are truncated, the race would go on, so they still hear each other.
        self._said = {a: message for a, message in said.items() if not terminations.get(a)}
        return self._with_messages(observations), rewards, terminations, truncations, infos

    def _message(self, agent: str, action: object) -> Message:
        parts = action if isinstance(action, Mapping) else {}
        if not {"action", "message"} <= set(parts):
            raise ActionError(
                f"the action of agent {agent!r} is {shortened(action)}; expected a dict of "
                "'action' and 'message'",
                agent,
            )
        said = read_action(self._message_space, parts["message"], agent, "message")
        message: Message = (
            said if self.words is None else np.eye(self.words, dtype=np.float32)[said]
        )
        return message

    def _with_messages(self, observations: dict[str, Any]) -> dict[str, Any]:
        return {a: {"observation": seen, **self._heard(a)} for a, seen in observations.items()}

    def _heard(self, agent: str) -> dict[str, Any]:
        """Returns the messages that an agent gets, and from which other agents."""
        others = [other for other in self.env.possible_agents if other != agent]
        messages = np.zeros((len(others), self.size), np.float32)
        heard = np.zeros(len(others), np.int8)
        for row, other in enumerate(others):
            if other in self._said and self._hears(agent, other):
                messages[row], heard[row] = self._said[other], 1
        return {"messages": messages, "heard": heard}

    def _hears(self, agent: str, other: str) -> bool:
        if self._team_of[agent] != self._team_of[other]:
            return False
        if math.isinf(self.reach):
            return True
        race: Any = self.env.unwrapped
        places = race.snapshot.karts["location"][list(race.race.kart_indices)]
        here, there = (places[self.possible_agents.index(name)] for name in (agent, other))
        return bool(np.linalg.norm(here - there) <= self.reach)


def _teams_in(env: Any) -> dict[str, int]:
    while isinstance(env, BaseParallelWrapper):
        if isinstance(env, Teams):
            return env.team_of
        env = env.env
    raise ConfigError("within_teams needs teams: put Teams(env, teams=...) inside MessageChannel")
