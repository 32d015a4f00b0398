"""Tools for multi-agent research: action masks, partial observability, teams and messages.

:class:`ActionMasks` and :class:`PartialObservations` wrap one agent, in views; :class:`Teams` and
:class:`MessageChannel` wrap the ``ParallelEnv``.
"""

from stkzoo.wrappers.marl.messages import MessageChannel
from stkzoo.wrappers.marl.observations import ActionMasks, PartialObservations
from stkzoo.wrappers.marl.teams import MATE_FEATURES, Teams

__all__ = [
    "MATE_FEATURES",
    "ActionMasks",
    "MessageChannel",
    "PartialObservations",
    "Teams",
]
__dir__ = __all__.copy
