"""Conduct: contacts, faults, time off the road and overtakes of karts in recorded races."""

from stkzoo.suite.conduct.counterfactuals import JudgedContact
from stkzoo.suite.conduct.races import (
    KartConduct,
    MeanConduct,
    RaceConduct,
    mean_conduct,
    measure_conduct,
    race_conduct,
)

__all__ = [
    "JudgedContact",
    "KartConduct",
    "MeanConduct",
    "RaceConduct",
    "mean_conduct",
    "measure_conduct",
    "race_conduct",
]
