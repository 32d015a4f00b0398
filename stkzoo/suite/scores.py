"""Normalized scores: 0 is the weakest and 1 the strongest driver that comes with stkzoo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from stkzoo._reading import load_json, reading
from stkzoo.errors import ConfigError
from stkzoo.evaluation.statistics import Estimate
from stkzoo.suite.population import population_digests
from stkzoo.suite.tasks import SUITE, TIME_RATIO, find_task

#: The scores of the drivers, measured by ``python -m benchmarks.suite_baselines``.
BASELINES_FILE = Path(__file__).parent / "baselines.json"


@dataclass(frozen=True, slots=True)
class Baselines:
    """The scores of the drivers that come with stkzoo.

    Attributes:
        suite: name of the suite.
        digests: digest of each task's definition, by its name.
        population: digest of each driver of the population at that time, by its name.
        scores: score of each driver in each task.
    """

    suite: str
    digests: Mapping[str, str]
    population: Mapping[str, str]
    scores: Mapping[str, Mapping[str, Estimate]]

    def has(self, task: str) -> bool:
        """Returns whether there are scores of a task's present definition and population.

        Args:
            task: name of the task.
        """
        definition = find_task(task)
        is_met = not definition.has_population or self.population == population_digests()
        return self.suite == SUITE and self.digests.get(task) == definition.digest and is_met

    def ends(self, task: str) -> tuple[float, float]:
        """Returns the scores of the weakest and of the strongest driver in a task.

        Args:
            task: name of the task.

        Raises:
            ConfigError: the task has no scores, or its definition has changed since.
        """
        if not self.has(task):
            raise ConfigError(
                f"{task} has no baselines yet; measure them: python -m benchmarks.suite_baselines"
            )
        values = sorted(score.value for score in self.scores[task].values())
        lowest, highest = values[0], values[-1]
        return (highest, lowest) if find_task(task).metric == TIME_RATIO else (lowest, highest)


@cache
def load_baselines() -> Baselines:
    """Returns the scores that come with stkzoo.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    with reading(f"{BASELINES_FILE} cannot be read", "the file that comes with stkzoo"):
        return load_json(BASELINES_FILE, Baselines)


def normalized(task: str, score: float, baselines: Baselines | None = None) -> float:
    """Returns a score on the scale of its task: 0 is the weakest baseline, 1 the strongest.

    Scores can be below 0 and above 1. Where less is better, as for time ratios, the scale is
    reversed.

    Args:
        task: name of the task.
        score: the score.
        baselines: scores of the baselines; by default, those that come with stkzoo.

    Raises:
        ConfigError: the task has no baselines.
    """
    weakest, strongest = (baselines or load_baselines()).ends(task)
    return (score - weakest) / (strongest - weakest)


def scale_ends(task: str) -> tuple[float, float]:
    """Returns the values of a task's metric that are 0 and 1 on its scale. Higher is better.

    The scale is that of :func:`normalized`. Without baselines, it is the metric itself, and a time
    ratio has a minus sign.

    Args:
        task: name of the task.
    """
    baselines = load_baselines()
    if baselines.has(task):
        return baselines.ends(task)
    return (0.0, -1.0) if find_task(task).metric == TIME_RATIO else (0.0, 1.0)
