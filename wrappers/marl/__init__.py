"""What research on many agents asks for beside the race itself.

:class:`ActionMasks` and :class:`PartialObservations` are wrappers of one agent, for views;
:class:`Teams` and :class:`MessageChannel` go around the ``ParallelEnv``.
"""

from stkzoo.wrappers.marl.masks import ActionMasks
from stkzoo.wrappers.marl.messages import MessageChannel
from stkzoo.wrappers.marl.partial import PartialObservations
from stkzoo.wrappers.marl.teams import Teams

__all__ = ["ActionMasks", "MessageChannel", "PartialObservations", "Teams"]
