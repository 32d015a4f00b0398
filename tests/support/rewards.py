"""Values of rewards in a single step."""

import numpy as np

from stkzoo.env.episode import _kernel_part
from stkzoo.kernel import StepScorer


def values_of(reward, step):
    """Returns the weighted value of each built-in term before limits, ``(K,)`` float64 by name."""
    names, karts = [*reward.terms], np.arange(step.num_kart)
    values, sums, owed, limits = np.zeros((4, step.num_kart, len(names)))
    numbers = values, sums, owed, limits + np.inf, step.race_length
    parts = (_kernel_part(reward, names),) * step.num_kart
    results = np.zeros(step.num_kart), *np.zeros((2, step.num_kart), np.bool_)
    scorer = StepScorer(karts, *numbers, parts, np.zeros(0))
    scorer.score_into(step.before.data, step.after.data, False, karts, karts, *results)
    return dict(zip(names, values.T, strict=True))
