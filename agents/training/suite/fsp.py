"""Fictitious self-play: PPO against itself and against all its past policies, drawn evenly.

    stkzoo suite train selfplay-5 fsp

Like independent PPO (:mod:`.ippo`), but in half of the races a past policy drives some of the
karts. Each of 40 past policies is equally likely, so that the learner finds a response to the mean
of its past policies (Heinrich et al., 2015).
"""

from __future__ import annotations

from functools import partial

from .learner import run_task
from .past import PastSelfPlay


class FSP(PastSelfPlay):
    """A run of fictitious self-play; see :class:`.past.PastSelfPlay`."""

    is_prioritized = False


run = partial(run_task, FSP)
