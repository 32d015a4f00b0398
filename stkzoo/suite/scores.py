"""Normalized scores: 0 is the weakest and 1 the strongest driver that comes with stkzoo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from stkzoo._reading import load_json, reading
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


@cache
def load_baselines() -> Baselines:
    """Returns the scores that come with stkzoo.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    with reading(f"{BASELINES_FILE} cannot be read", "the file that comes with stkzoo"):
        return load_json(BASELINES_FILE, Baselines)


def scale_ends(task: str) -> tuple[float, float]:
    """Returns the values of a task's metric that are 0 and 1 on its scale. Higher is better.

    They are the scores of the weakest and of the strongest driver that comes with stkzoo. Without
    baselines, the scale is the metric itself, and a time ratio has a minus sign.

    Args:
        task: name of the task.
    """
    baselines, is_time = load_baselines(), find_task(task).metric == TIME_RATIO
    if not baselines.has(task):
        return (0.0, -1.0) if is_time else (0.0, 1.0)
    values = [score.value for score in baselines.scores[task].values()]
    return (max(values), min(values)) if is_time else (min(values), max(values))


def normalized(task: str, score: float) -> float | None:
    """Returns a score on the scale of its task: 0 is the weakest baseline, 1 the strongest.

    Scores can be below 0 and above 1.

    Args:
        task: name of the task.
        score: the score.

    Returns:
        The normalized score; ``None`` if the task has no baselines.
    """
    if not load_baselines().has(task):
        return None
    weakest, strongest = scale_ends(task)
    return (score - weakest) / (strongest - weakest)
