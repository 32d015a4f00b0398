"""Words in the view of one kart, for agents that talk in races.

In a race, each agent is wrapped on its own, so no :class:`~stkzoo.wrappers.marl.MessageChannel`
wraps all of them. Instead, the race adds the words to the observations of the kart and takes
them from its actions (:class:`WordChannel`), and :class:`TalkingView` gives both the form of
``MessageChannel``.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionObservationWrapper
from stkzoo.views.registry import ViewFactory
from stkzoo.wrappers.arguments import dict_space
from stkzoo.wrappers.marl.messages import heard_spaces

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
