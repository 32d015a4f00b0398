"""Normalized scores: *random* has 0 and *zenith* has 1 in the same races, by definition."""

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
#: The drivers whose scores are 0 and 1 on the scale of a task.
ZERO, ONE = "random", "pretrained:zenith"


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
        """Returns whether both ends of a task's scale are known.

        They are scores in the races of its present definition, against the present population.

        Args:
            task: name of the task.
        """
        definition = find_task(task)
        is_met = not definition.has_population or self.population == population_digests()
        is_known = {ZERO, ONE} <= self.scores.get(task, {}).keys()
        is_same = self.suite == SUITE and self.digests.get(task) == definition.digest
        return is_known and is_same and is_met


@cache
def load_baselines() -> Baselines:
    """Returns the scores that come with stkzoo.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    with reading(f"{BASELINES_FILE} cannot be read", "the file that comes with stkzoo"):
        return load_json(BASELINES_FILE, Baselines)


def scale_ends(task: str, fresh: str = "") -> tuple[float, float]:
    """Returns the values of a task's metric that are 0 and 1 on its scale. Higher is better.

    They are the scores of *random* and *zenith*. Without them, and in fresh races, the scale is the
    metric itself, and a time ratio has a minus sign.

    Args:
        task: name of the task.
        fresh: text from which the seeds of the races are drawn; empty for those of the task.
    """
    baselines, is_time = load_baselines(), find_task(task).metric == TIME_RATIO
    if fresh or not baselines.has(task):
        return (0.0, -1.0) if is_time else (0.0, 1.0)
    scores = baselines.scores[task]
    return scores[ZERO].value, scores[ONE].value


def normalized(task: str, score: float) -> float | None:
    """Returns a score on the scale of its task, where *random* has 0 and *zenith* has 1.

    Scores can be below 0 and above 1.

    Args:
        task: name of the task.
        score: the score.

    Returns:
        The normalized score; ``None`` if the two drivers have not been measured in the task.
    """
    if not load_baselines().has(task):
        return None
    zero, one = scale_ends(task)
    return (score - zero) / (one - zero)
