"""Independent PPO: every learner learns from its own observations and rewards, with one policy.

    stkzoo suite train versus ippo

All learners of a task share one policy and one value network, which see the view `racing` of one
kart; other learners are part of its environment (de Witt et al., 2020).
"""

from __future__ import annotations

from functools import partial

from .learner import TaskLearner, run_task


class IPPO(TaskLearner):
    """A run of independent PPO; see :class:`.learner.TaskLearner`."""


run = partial(run_task, IPPO)
