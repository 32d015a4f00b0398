"""Names of ``pystk2_gymnasium.stk_wrappers``."""

from stkzoo._pystk2_gymnasium.envs import STKAction as STKAction
from stkzoo._pystk2_gymnasium.envs import STKDiscreteAction as STKDiscreteAction
from stkzoo._pystk2_gymnasium.utils import max_enum_value as max_enum_value
from stkzoo.wrappers import ActionObservationWrapper as ActionObservationWrapper
from stkzoo.wrappers import ConstantSizedObservations as ConstantSizedObservations
from stkzoo.wrappers import DiscreteActionsWrapper as DiscreteActionsWrapper
from stkzoo.wrappers import Discretizer as Discretizer
from stkzoo.wrappers import OnlyContinuousActionsWrapper as OnlyContinuousActionsWrapper
from stkzoo.wrappers import PolarObservations as PolarObservations
