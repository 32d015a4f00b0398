"""Runs one agent's code in one race. Knows nothing of processes or networks."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.race.agent_code import AgentCode
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.batch import split

__all__ = ["AgentRunner"]


class AgentRunner:
    """An agent with its view, its wrappers and its state, from ``full`` to ``full``.

    The wrappers see what the agent sees and does; rewards, infos and ends do not come
    along: they are 0, empty and ``False``.

    Args:
        code: the agent's code.
        agent: its id.
        observation_space: of the observations that :meth:`act` is given.
        action_space: of the actions that it returns.
        seed: decides what the agent draws from its action space.

    Raises:
        Exception: whatever the agent's code raises, here and in :meth:`act`.
    """

    def __init__(
        self,
        code: AgentCode,
        agent: str,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        seed: int,
    ) -> None:
        self._code, self._base = code, action_space
        self._is_begun = False
        with code.scope:
            self._chain = AgentChain(agent, observation_space, action_space, code.wrap)
            self._chain.action_space.seed(seed)
            view = self._chain.observation_space, self._chain.action_space
            self._actor = code.make_actor(*view, seed)
        self._seed = seed

    @property
    def name(self) -> str:
        """What the agent calls itself; empty if it does not say."""
        return self._code.name

    @property
    def paths_used(self) -> int | None:
        """How many track segments the agent looks at; ``None`` is all."""
        return self._chain.paths_used()

    def act(self, observation: Any) -> Any:
        """The agent's action, in the game's own form.

        Args:
            observation: what its kart sees in the ``full`` view.

        Raises:
            ActionError: the action is not in the agent's own action space.
        """
        with self._code.scope:
            seen = self._see(observation)
            try:
                action = self._decode(self._actor(seen))
            except BaseException:
                self._stand_in()
                raise
            self._is_begun = True
            return action

    def close(self) -> None:
        """Closes the agent's wrappers."""
        with self._code.scope:
            self._chain.close()

    def _see(self, observation: Any) -> Any:
        """The agent's view, by the wrappers' ``step`` if one was begun, else by ``reset``."""
        if not self._is_begun:
            return self._chain.reset(observation, {}, seed=self._seed)[0]
        self._is_begun = False
        return self._chain.finish_step((observation, 0.0, False, False, {}))[0]

    def _decode(self, action: Any) -> Any:
        """The game's own action; checked again behind wrappers that are the agent's own."""
        checked = self._chain.read_action(action)
        if self._chain.is_batched:
            return self._chain.begin_step(checked)
        return split(self._base, self._chain.begin_base_step(checked))[0]

    def _stand_in(self) -> None:
        """Begins a step for an agent that failed, so that its wrappers keep their memory."""
        with suppress(Exception):
            self._chain.begin_step(create_zero_array(self._chain.action_space))
            self._is_begun = True
