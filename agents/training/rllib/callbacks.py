"""Callbacks that RLlib calls during ``rllib.selfplay``. Needs Ray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ray.rllib.callbacks.callbacks import RLlibCallback
from ray.rllib.core import COMPONENT_LEARNER, COMPONENT_RL_MODULE
from ray.rllib.utils.metrics import ENV_RUNNER_RESULTS

from .races import MAIN, RLlibArguments

#: Names of the logged figures.
WIN_SHARE, RACES, RESTARTED = "win_share", "races", "restarted"


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
        result["promotions"] = self.promotions
        result[RESTARTED] = self.restarts
        arguments, wins = self._arguments, figures.get(WIN_SHARE, 0.0)
        is_due = races - self._races_then >= arguments.least_races
        if not arguments.frozen or not is_due or wins < arguments.promote_at:
            return
        copy_main(algorithm, arguments.slot(self.promotions))
        self.promotions += 1
        self._races_then = races
        result["promotions"] = self.promotions

    def on_env_runners_recreated(self, *, env_runner_indices: list[int], **_: Any) -> None:
        """Counts the restarted env runners."""
        self.restarts += len(env_runner_indices)


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
