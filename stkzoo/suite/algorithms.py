"""The reference algorithms, and the tasks that they can learn."""

from __future__ import annotations

from stkzoo.suite.tasks import Task

#: Reference algorithms (``stkzoo.agents.training.suite.algorithms``), and the least number of
#: learners of their tasks: self-play needs two.
ALGORITHMS = {"ippo": 1, "mappo": 1, "fsp": 2, "pfsp": 2, "impala": 1}


def can_learn(algorithm: str, task: Task) -> bool:
    """Returns whether an algorithm can learn a task; true for all other algorithms.

    Args:
        algorithm: name of the algorithm.
        task: the task.
    """
    if algorithm not in ALGORITHMS:
        return True
    return not task.words and task.learners >= ALGORITHMS[algorithm]
