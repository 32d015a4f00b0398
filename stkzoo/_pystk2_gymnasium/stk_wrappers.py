"""Names of ``pystk2_gymnasium.stk_wrappers``."""

from stkzoo.wrappers import ConstantSizedObservations as ConstantSizedObservations
from stkzoo.wrappers import DiscreteActionsWrapper as DiscreteActionsWrapper
from stkzoo.wrappers import OnlyContinuousActionsWrapper as OnlyContinuousActionsWrapper
from stkzoo.wrappers import PolarObservations as PolarObservations
