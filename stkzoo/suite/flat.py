"""Tasks with flat spaces: one vector per observation, one number or one vector per action.

Many algorithms need that. The view ``racing`` has five choices per action, and ``talk-2v2`` has
dicts; :class:`FlatTask` converts both. The races stay the same.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo.agent_names import require_actions
from stkzoo.errors import ActionError, ConfigError, unknown_name
from stkzoo.views.walker import StepParts
from stkzoo.wrappers.racing import BRAKE, CHOICES, STEERS

_Choices = npt.NDArray[np.int64]

_GO = 0
#: Steering of full left, left, slightly left, straight, slightly right, right, full right.
_STEERING = tuple(len(STEERS) // 2 + offset for offset in (-10, -6, -3, 0, 3, 6, 10))


def _few_choices() -> _Choices:
    """Returns the rows of :data:`FEW_CHOICES`."""
    full_left, left, slight_left, straight, slight_right, right, full_right = _STEERING
    rows = [(steer, _GO, 0, 0, 0) for steer in _STEERING]
    rows += [(steer, _GO, 1, 0, 0) for steer in (full_left, left, right, full_right)]
    rows += [(steer, _GO, 0, 1, 0) for steer in (slight_left, straight, slight_right)]
    rows += [(straight, _GO, 0, 0, 1)]
    rows += [(steer, BRAKE, 0, 0, 0) for steer in (full_left, straight, full_right)]
    return np.array(rows, np.int64)


#: The actions of the form ``"few"``, ``(18, 5)``: a row of choices of the view ``racing`` for each.
#: Steering of -1, -0.4, -0.16, 0, 0.16, 0.4 or 1 at full throttle; drifts; nitro; fire; the brake.
FEW_CHOICES = _few_choices()
#: The actions of the form ``"all"``, ``(672, 5)``: all combinations of choices.
ALL_CHOICES: _Choices = np.stack([grid.ravel() for grid in np.indices(CHOICES)], axis=-1)
_TABLES = {"few": FEW_CHOICES, "all": ALL_CHOICES}
#: Name of the form with continuous actions.
CONTINUOUS = "continuous"
#: Forms of actions.
ACTION_FORMS = (*_TABLES, CONTINUOUS)

#: Thresholds of the form ``"continuous"``: below the first, the pedal brakes, and above the second,
#: a button is pressed. Actions near 0 drive straight ahead.
_BRAKES_BELOW, _PRESSES_ABOVE = -0.5, 0.5


class FlatTask(BaseParallelWrapper[str, Any, Any]):
    """A task whose observations are vectors and whose actions are numbers or vectors.

    Observations are flattened in the order of their space. The vector of ``talk-2v2`` is
    ``heard``, 3 numbers; ``messages``, 3 times 8; and the view's 165 numbers.

    Actions have one of three forms:

    - ``"few"``: ``Discrete(18)``, a row of :data:`FEW_CHOICES`. A policy that chooses at random
      drives on. None of the actions coasts or calls the rescue.
    - ``"all"``: ``Discrete(672)``, a row of :data:`ALL_CHOICES`. Random choices rarely get
      anywhere, because one in four calls the rescue.
    - ``"continuous"``: ``Box(-1, 1, (5,))``. The numbers are steering, which takes the nearest of
      the view's 21 values; the pedal, which brakes below -0.5; and drift, nitro and fire, which are
      on above 0.5.

    If agents send one of W words, the word multiplies the numbers (``action * W + word``), and
    the continuous form has W more entries. The index of the largest is the word.

    Args:
        env: the environment of a task (:meth:`Task.make <stkzoo.suite.Task.make>`).
        actions: form of the actions.

    Raises:
        ConfigError: there is no such form, or the environment has other actions.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any], *, actions: str = "few") -> None:
        super().__init__(env)
        if actions not in ACTION_FORMS:
            raise unknown_name("form of actions", actions, ACTION_FORMS)
        first = env.action_space(env.possible_agents[0])
        self.words = _words_of(first)
        self._table = _TABLES.get(actions)
        agents = env.possible_agents
        self._observation_spaces = {
            agent: spaces.flatten_space(env.observation_space(agent)) for agent in agents
        }
        self._action_spaces = {agent: self._flat_space() for agent in agents}
        self._read: Callable[[Any], tuple[_Choices, int]] = (
            partial(_read_numbers, self.words)
            if self._table is None
            else partial(_read_row, self._table, self.words)
        )

    def _flat_space(self) -> spaces.Space[Any]:
        if self._table is None:
            return spaces.Box(-1.0, 1.0, (len(CHOICES) + self.words,), np.float32)
        return spaces.Discrete(len(self._table) * max(self.words, 1))

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space, the same object on every call."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's action space, the same object on every call."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the race."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._flattened(observations), infos

    def step(self, actions: dict[str, Any]) -> StepParts:
        """Steps the race.

        Raises:
            ActionError: an action is missing or invalid; the race has not advanced.
        """
        require_actions(actions, self.env.agents)
        racing = {agent: self._action(agent, actions.get(agent)) for agent in self.env.agents}
        observations, *rest = self.env.step(racing)
        return (self._flattened(observations), *rest)

    def _flattened(self, observations: dict[str, Any]) -> dict[str, Any]:
        if not self.words:
            return observations
        inner = self.env.observation_space
        return {agent: spaces.flatten(inner(agent), seen) for agent, seen in observations.items()}

    def _action(self, agent: str, action: Any) -> Any:
        if not self._action_spaces[agent].contains(action):
            raise ActionError(
                f"the action of {agent!r} is {action!r:.200}, not in "
                f"{self._action_spaces[agent]!r}",
                agent,
            )
        choices, word = self._read(action)
        return {"action": choices, "message": word} if self.words else choices


def _read_row(table: _Choices, words: int, number: Any) -> tuple[_Choices, int]:
    """Returns the choices and the word of a discrete action."""
    row, word = divmod(int(number), max(words, 1))
    return table[row], word


def _read_numbers(words: int, numbers: Any) -> tuple[_Choices, int]:
    """Returns the choices and the word of a continuous action."""
    steer, pedal, *buttons = numbers[: len(CHOICES)]
    pressed = [button > _PRESSES_ABOVE for button in buttons]
    nearest = np.abs(STEERS - steer).argmin()
    choices = [nearest, BRAKE if pedal < _BRAKES_BELOW else _GO, *pressed]
    word = int(np.argmax(numbers[len(CHOICES) :])) if words else 0
    return np.array(choices, np.int64), word


def _words_of(space: spaces.Space[Any]) -> int:
    """Returns the size of the vocabulary in an action space of a task; 0 without messages."""
    action, words = space, 0
    if isinstance(space, spaces.Dict) and {*space} == {"action", "message"}:
        action, message = space["action"], space["message"]
        words = int(message.n) if isinstance(message, spaces.Discrete) else 0
    is_racing = isinstance(action, spaces.MultiDiscrete) and tuple(action.nvec) == CHOICES
    if not is_racing or (action is not space and not words):
        raise ConfigError(f"FlatTask needs the actions of the view 'racing', found {space!r:.200}")
    return words
