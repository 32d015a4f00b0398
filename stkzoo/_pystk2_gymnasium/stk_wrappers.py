"""Names of ``pystk2_gymnasium.stk_wrappers``."""

from stkzoo.wrappers import (
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)

__all__ = [
    "ConstantSizedObservations",
    "DiscreteActionsWrapper",
    "OnlyContinuousActionsWrapper",
    "PolarObservations",
]
