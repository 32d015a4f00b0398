"""Callbacks that RLlib calls during ``rllib.selfplay``. Needs Ray."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from ray.rllib.callbacks.callbacks import RLlibCallback
from ray.rllib.core import COMPONENT_LEARNER, COMPONENT_RL_MODULE
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS, NUM_EPISODES

from .races import MAIN, RLlibArguments

#: Names of the logged figures.
RETURN, WIN_SHARE, RACES, RESTARTED = "return", "win_share", "races", "restarted"
#: Sums over the races of an iteration: of their returns, and of their shares of duels won.
RETURNS, WIN_SHARES = "returns", "win_shares"
#: Number of races in the means of the log.
_RECENT = 50


class SelfPlay(RLlibCallback):
    """Logs results, and saves a frozen snapshot of the learner when it wins often enough.

    Args:
        arguments: arguments of the run.
    """

    def __init__(self, arguments: RLlibArguments) -> None:
        super().__init__()
        self._arguments = arguments
        self.promotions = 0
        self.restarts = 0
        self._races_then = 0.0
        self._recent = RecentRaces()

    def remember(self, promotions: int, races: float) -> None:
        """Restores the progress of a run; its last snapshot was made after ``races`` races."""
        self.promotions, self._races_then = promotions, races

    def on_algorithm_init(self, *, algorithm: Any, **_: Any) -> None:
        """Initializes all past selves with the learner's weights."""
        for module in self._arguments.modules[1:]:
            copy_main(algorithm, module)

    def on_train_result(self, *, algorithm: Any, result: dict[str, Any], **_: Any) -> None:
        """Promotes the learner if it wins often enough."""
        figures: Mapping[str, float] = result.get(ENV_RUNNER_RESULTS, {})
        races = float(figures.get(RACES, 0.0))
        self._recent.add(*(_sum(figures, name) for name in (NUM_EPISODES, RETURNS, WIN_SHARES)))
        result[RETURN], wins = self._recent.means()
        arguments = self._arguments
        is_due = races - self._races_then >= arguments.least_races
        if arguments.frozen and is_due and wins >= arguments.promote_at:
            copy_main(algorithm, arguments.slot(self.promotions))
            self.promotions += 1
            self._races_then = races
            self._recent = RecentRaces()
        result[WIN_SHARE] = wins if arguments.frozen else math.nan
        result["promotions"] = self.promotions
        result[RESTARTED] = self.restarts

    def on_env_runners_recreated(self, *, env_runner_indices: list[int], **_: Any) -> None:
        """Counts the restarted env runners."""
        self.restarts += len(env_runner_indices)


class RecentRaces:
    """The iterations in which the latest races since a snapshot ended.

    RLlib's own means cover one iteration, and count the mean of each env runner once.
    """

    def __init__(self) -> None:
        self._iterations: deque[tuple[float, float, float]] = deque()

    def add(self, races: float, returns: float, win_shares: float) -> None:
        """Adds the sums of an iteration, and drops the oldest that are no longer needed."""
        self._iterations.append((races, returns, win_shares))
        while sum(races for races, *_ in self._iterations) - self._iterations[0][0] >= _RECENT:
            self._iterations.popleft()

    def means(self) -> tuple[float, float]:
        """Returns the mean return and share of duels won of a race; NaN without races."""
        races, returns, win_shares = map(sum, zip(*self._iterations, strict=True))
        return (returns / races, win_shares / races) if races else (math.nan, math.nan)


def _sum(figures: Mapping[str, float], name: str) -> float:
    """Returns a sum over an iteration, which RLlib leaves out or calls NaN if it has no values."""
    value = figures.get(name, 0.0)
    return 0.0 if math.isnan(value) else float(value)


def copy_main(algorithm: Any, module: str) -> None:
    """Copies the learner's weights to a frozen module, on all learners and env runners."""

    def copy(learner: Any) -> None:
        learner.module[module].load_state_dict(learner.module[MAIN].state_dict())

    algorithm.learner_group.foreach_learner(copy)
    path = f"{COMPONENT_LEARNER}/{COMPONENT_RL_MODULE}/{module}"
    state = algorithm.learner_group.get_state(components=path, inference_only=True)
    weights = {COMPONENT_RL_MODULE: state[COMPONENT_LEARNER][COMPONENT_RL_MODULE]}
    # Env runners skip weights with a number that they already have; these weights have none.
    algorithm.env_runner_group.foreach_env_runner(lambda runner: runner.set_state(weights))
