"""Names of ``pystk2_gymnasium.definitions``."""

from stkzoo.config import AgentSpec
from stkzoo.errors import AgentException
from stkzoo.names import CameraMode
from stkzoo.wrappers import ActionObservationWrapper

__all__ = ["ActionObservationWrapper", "AgentException", "AgentSpec", "CameraMode"]
