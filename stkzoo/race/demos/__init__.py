"""Demonstrations: what drivers saw and what they did then, as a data set to learn from.

>>> from stkzoo.race.demos import load, record  # doctest: +SKIP
>>> demos = record("heuristic", output="demos.npz", tracks="lighthouse")  # doctest: +SKIP
>>> observations, actions = demos.pairs()  # doctest: +SKIP
"""

from __future__ import annotations

from stkzoo.race.demos.check import Check, check
from stkzoo.race.demos.dataset import Demonstrations, Episode, EpisodeFacts, load, save
from stkzoo.race.demos.minari import to_minari
from stkzoo.race.demos.plan import DemoPlan, plan_demos
from stkzoo.race.demos.run import DemosError, record

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
