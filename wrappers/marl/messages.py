"""Messages between agents: a channel around an environment, and words in races."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo._checks import check_number, check_whole
from stkzoo.agent_names import of_agent, require_actions
from stkzoo.errors import ActionError, ConfigError
from stkzoo.views.bases import ActionObservationWrapper
from stkzoo.views.registry import ViewFactory
from stkzoo.views.walker import StepParts
from stkzoo.wrappers.arguments import dict_space
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
        for agent in env.possible_agents:
            seen, action = map(
                copy.deepcopy, (env.observation_space(agent), env.action_space(agent))
            )
            heard = heard_spaces(len(env.possible_agents) - 1, self.size)
            self._observation_spaces[agent] = spaces.Dict({"observation": seen, **heard})
            said = copy.deepcopy(self._message_space)
            self._action_spaces[agent] = spaces.Dict({"action": action, "message": said})

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
        require_actions(actions, self.env.agents)
        said = {agent: self._message(agent, actions) for agent in self.env.agents}
        bare = {agent: action["action"] for agent, action in actions.items() if agent in said}
        observations, rewards, terminations, truncations, infos = self.env.step(bare)
        # For agents that are truncated, the race would go on, so they still hear each other.
        self._said = {a: message for a, message in said.items() if not terminations.get(a)}
        return self._with_messages(observations), rewards, terminations, truncations, infos

    def _message(self, agent: str, actions: Mapping[str, Any]) -> Message:
        action = actions.get(agent)
        parts = action if isinstance(action, Mapping) else {}
        if not {"action", "message"} <= set(parts):
            raise ActionError(
                f"the action of {agent!r} has to be a dict of 'action' and 'message', but is "
                f"{action!r:.200}",
                agent,
            )
        message: Any = parts["message"]
        is_readable = True
        if self.words is None:
            try:
                message = np.array(message, np.float32)
            except (TypeError, ValueError, OverflowError, RuntimeError):  # of torch, too
                is_readable = False
        if not is_readable or not self._message_space.contains(message):
            raise ActionError(
                f"the message of {agent!r} is {message!r:.200}, not in {self._message_space!r}",
                agent,
            )
        row: Message = message if self.words is None else message_of(int(message), self.words)
        return row

    def _with_messages(self, observations: dict[str, Any]) -> dict[str, Any]:
        heard = {}
        for agent in observations:
            others = [other for other in self.env.possible_agents if other != agent]
            said = [self._said.get(o) if self._hears(agent, o) else None for o in others]
            heard[agent] = heard_messages(said, self.size)
        return {a: {"observation": seen, **heard[a]} for a, seen in observations.items()}

    def _hears(self, agent: str, other: str) -> bool:
        if self._team_of[agent] != self._team_of[other]:
            return False
        if math.isinf(self.reach):
            return True
        race: Any = self.env.unwrapped
        places = race.snapshot.karts["location"][list(race.race.kart_indices)]
        here, there = (places[self.possible_agents.index(name)] for name in (agent, other))
        return bool(np.linalg.norm(here - there) <= self.reach)


def heard_spaces(others: int, size: int) -> dict[str, spaces.Space[Any]]:
    """Returns new spaces of the entries of :func:`heard_messages`.

    Args:
        others: number of the other agents.
        size: length of a message.
    """
    return {
        "messages": spaces.Box(-1, 1, (others, size)),
        "heard": spaces.Box(0, 1, (others,), np.int8),
    }


def heard_messages(said: Sequence[Message | None], size: int) -> dict[str, Any]:
    """Returns what an agent hears.

    Args:
        said: the message of each other agent, in agent order; ``None`` for agents not heard.
        size: length of a message.

    Returns:
        ``messages``, ``(others, size)`` float32, and ``heard``, ``(others,)`` int8; see
            :class:`MessageChannel`.
    """
    messages = np.zeros((len(said), size), np.float32)
    heard = np.zeros(len(said), np.int8)
    for row, message in enumerate(said):
        if message is not None:
            messages[row], heard[row] = message, 1
    return {"messages": messages, "heard": heard}


def message_of(word: int, words: int) -> Message:
    """Returns a word as a one-hot message ``(words,)`` float32.

    Args:
        word: number of the word.
        words: number of words.
    """
    message: Message = np.eye(words, dtype=np.float32)[word]
    return message


def _teams_in(env: Any) -> dict[str, int]:
    while isinstance(env, BaseParallelWrapper):
        if isinstance(env, Teams):
            return env.team_of
        env = env.env
    raise ConfigError("within_teams needs teams: put Teams(env, teams=...) inside MessageChannel")


# ---------------------------------------------------------------------- words
# In a race, each agent is wrapped on its own, so no MessageChannel wraps all of them. Instead, the
# race adds the words to the observations of the kart and takes them from its actions.

#: Entries of an observation with words, beyond those of the kart, and the entry of an action.
_HEARD, _SAID = ("messages", "heard"), "message"


@dataclass(frozen=True, slots=True)
class WordChannel:
    """Spaces of the words that a kart of a race hears and says.

    Attributes:
        words: number of words.
        others: number of the other karts.
    """

    words: int
    others: int

    def observation_space(self, own: spaces.Space[Any]) -> spaces.Dict:
        """Returns a kart's observation space with what it hears: ``messages`` and ``heard``.

        Args:
            own: space of the observations without words.
        """
        parts = dict_space(own, "observations", "WordChannel").spaces
        return spaces.Dict({**parts, **heard_spaces(self.others, self.words)})

    def action_space(self, own: spaces.Space[Any]) -> spaces.Dict:
        """Returns a kart's action space with the word that it says: ``message``.

        Args:
            own: space of the actions without words.
        """
        parts = dict_space(own, "actions", "WordChannel").spaces
        return spaces.Dict({**parts, _SAID: spaces.Discrete(self.words)})


@dataclass(frozen=True, slots=True)
class TalkingView:
    """A view of an agent that hears and says words.

    Actions are dicts of ``action`` and ``message``; observations are dicts of ``observation``,
    ``messages`` and ``heard``, as in :class:`~stkzoo.wrappers.marl.MessageChannel`.

    Attributes:
        view: view of the driving action and of the observation.
        words: number of words.
    """

    view: ViewFactory
    words: int

    def __call__(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """Wraps an environment in the ``full`` view with words (:class:`WordChannel`).

        Raises:
            ConfigError: the environment has no words.
        """
        words = _WithoutWords(env)
        return _WithWords(self.view(words), words)


class _WithoutWords(ActionObservationWrapper):
    """Hides the words from the view around it, and keeps them for :class:`_WithWords`.

    Attributes:
        spaces: spaces of the hidden entries.
        heard: hidden entries of the last observation.
        message: word that the next action says.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        seen = dict_space(env.observation_space, "observations", "TalkingView").spaces
        acted = dict_space(env.action_space, "actions", "TalkingView").spaces
        if not {*_HEARD} <= seen.keys() or _SAID not in acted:
            raise ConfigError(
                "the agent talks, but no words are carried here. Agents talk in races "
                "(stkzoo race, stkzoo suite evaluate), not on servers or as opponents of an "
                "environment; their module must assign env_name as a literal"
            )
        self.spaces = {key: seen[key] for key in _HEARD} | {_SAID: acted[_SAID]}
        self.observation_space = spaces.Dict(_without(seen, _HEARD))
        self.action_space = spaces.Dict(_without(acted, (_SAID,)))
        self.heard: dict[str, Any] = {}
        self.message = 0

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """Returns the observation without words."""
        self.heard = {key: observation[key] for key in _HEARD}
        return _without(observation, _HEARD)

    def action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Returns the action with the word."""
        return {**action, _SAID: self.message}


class _WithWords(ActionObservationWrapper):
    """Adds the words that :class:`_WithoutWords` keeps, in the form of ``MessageChannel``."""

    def __init__(self, env: gym.Env[Any, Any], words: _WithoutWords) -> None:
        super().__init__(env)
        self._words, parts = words, copy.deepcopy(words.spaces)
        self.action_space = spaces.Dict(
            {"action": copy.deepcopy(env.action_space), _SAID: parts.pop(_SAID)}
        )
        self.observation_space = spaces.Dict(
            {"observation": copy.deepcopy(env.observation_space), **parts}
        )

    def observation(self, observation: Any) -> dict[str, Any]:
        """Returns the observation with what the kart hears."""
        return {"observation": observation, **self._words.heard}

    def action(self, action: dict[str, Any]) -> Any:
        """Returns the driving action."""
        self._words.message = action[_SAID]
        return action["action"]


def _without(values: dict[str, Any], keys: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in keys}
