"""Multi-agent PPO: the value network sees the whole race, the policy only its own kart's view.

    stkzoo suite train team-2v2 mappo

Like independent PPO (:mod:`.ippo`), but with a centralized critic (Yu et al., 2022). Its inputs are
a learner's observation and the state of the race (`env.state()`), scaled by fixed typical values.
The trained agent does not need the critic.
"""

from __future__ import annotations

from functools import partial

from .learner import TaskLearner, run_task


class MAPPO(TaskLearner):
    """A run of multi-agent PPO; see :class:`.learner.TaskLearner`."""

    sees_state = True


run = partial(run_task, MAPPO)
