"""Views: what an agent observes and how it acts, and the machinery that runs them.

:data:`VIEWS` has the views by name. A view is a chain of Gymnasium wrappers
(:mod:`stkzoo.wrappers`); :class:`AgentChains` runs the chains of all agents of a race.
"""

from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.chains import AgentChains
from stkzoo.views.plan import ViewPlan
from stkzoo.views.shipped import (
    CAMERA_VIEWS,
    VIEWS,
    View,
    ViewFactory,
    sees_ground,
    views_of_agents,
)

__all__ = [
    "CAMERA_VIEWS",
    "VIEWS",
    "AgentChain",
    "AgentChains",
    "View",
    "ViewFactory",
    "ViewPlan",
    "sees_ground",
    "views_of_agents",
]
