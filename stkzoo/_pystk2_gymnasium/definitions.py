"""Names of ``pystk2_gymnasium.definitions``."""

from stkzoo.config import AgentSpec as AgentSpec
from stkzoo.errors import AgentException as AgentException
from stkzoo.names import CameraMode as CameraMode
from stkzoo.wrappers import ActionObservationWrapper as ActionObservationWrapper
