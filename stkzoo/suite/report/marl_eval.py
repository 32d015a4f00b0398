"""Results in the form of MARL-eval: environment, task, algorithm, run, step, metrics.

MARL-eval (Gorsane et al., 2022, https://github.com/instadeepai/marl-eval) requires the same metrics
in all steps and in the absolute metrics of an environment. Training and evaluation measure
different things, so they are two environments:

- ``stkzoo-suite-1`` has one step, the end of the training, with the score of each race on the test
  tracks, on the scale of the task;
- ``stkzoo-suite-1-training`` has the learning curve, at equal distances.

It also requires the same algorithms and seeds in all tasks.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from stkzoo.suite.report.results import LearningCurve, SuiteRun
from stkzoo.suite.scores import scale_ends
from stkzoo.suite.tasks import SUITE

_NUM_STEPS = 50
#: Names of the metrics by fields of :class:`~stkzoo.suite.report.results.LearningCurve`.
_METRICS = {"returns": "return", "finished": "finished", "position": "position"}


def marl_eval_json(runs: Sequence[SuiteRun]) -> str:
    """Returns runs as JSON text for MARL-eval.

    Args:
        runs: the runs.
    """
    environments: dict[str, Any] = {SUITE: {}, f"{SUITE}-training": {}}
    for run in runs:
        for tasks, steps in zip(
            environments.values(), (_evaluation(run), _training(run)), strict=True
        ):
            algorithms = tasks.setdefault(run.task, {})
            algorithms.setdefault(run.algorithm, {})[f"seed_{run.seed}"] = steps
    return json.dumps(environments, allow_nan=False, separators=(",", ":")) + "\n"


def _evaluation(run: SuiteRun) -> dict[str, Any]:
    zero, one = scale_ends(run.task)
    score = [(race.value - zero) / (one - zero) for race in run.test.races]
    step = {"step_count": run.kart_steps, "score": score}
    return {"step_0": step, "absolute_metrics": {"score": score}}


def _training(run: SuiteRun) -> dict[str, Any]:
    steps = _steps(run.curve)
    last = {name: value for name, value in steps[-1].items() if name != "step_count"}
    return {f"step_{n}": step for n, step in enumerate(steps)} | {"absolute_metrics": last}


def _steps(curve: LearningCurve) -> list[dict[str, Any]]:
    """Returns the metrics at equal distances, from the first race that ended."""
    known = [n for n, value in enumerate(curve.returns) if value is not None] or [0]
    at = np.array([curve.kart_steps[n] for n in known], float)
    counts = np.linspace(at[0], at[-1], _NUM_STEPS)
    steps: list[dict[str, Any]] = [{"step_count": round(count)} for count in counts]
    for field, name in _METRICS.items():
        values = [getattr(curve, field)[n] for n in known]
        has_values = None not in values
        at_counts = np.interp(counts, at, values) if has_values else counts
        for step, value in zip(steps, at_counts.tolist(), strict=True):
            step[name] = [round(value, 6)] if has_values else []
    return steps
