"""Demonstrations: what drivers saw and what they did then, as a data set to learn from.

>>> from stkzoo.evaluation.demonstrations import load, record  # doctest: +SKIP
>>> demos = record("heuristic", output="demos.npz", tracks="lighthouse")  # doctest: +SKIP
>>> observations, actions = demos.pairs()  # doctest: +SKIP
"""

from __future__ import annotations

from stkzoo.evaluation.demonstrations.check import Check, check
from stkzoo.evaluation.demonstrations.dataset import (
    Demonstrations,
    Episode,
    EpisodeFacts,
    load,
    save,
)
from stkzoo.evaluation.demonstrations.minari import to_minari
from stkzoo.evaluation.demonstrations.plan import DemoPlan, plan_demos
from stkzoo.evaluation.demonstrations.run import DemosError, record

__all__ = [
    "Check",
    "DemoPlan",
    "Demonstrations",
    "DemosError",
    "Episode",
    "EpisodeFacts",
    "check",
    "load",
    "plan_demos",
    "record",
    "save",
    "to_minari",
]
