"""Prioritized fictitious self-play: PPO against itself and the past policies that it beats least.

    stkzoo suite train selfplay-5 pfsp

Like fictitious self-play (:mod:`.fsp`), but a past policy that is beaten with probability p is
drawn with weight (1 - p)^2 (Vinyals et al., 2019). Each weight is 0.02 higher here, so that every
policy can be drawn.
"""

from __future__ import annotations

from functools import partial

from .learner import run_task
from .past import PastSelfPlay


class PFSP(PastSelfPlay):
    """A run of prioritized fictitious self-play; see :class:`.past.PastSelfPlay`."""

    is_prioritized = True


run = partial(run_task, PFSP)
