"""Views: how an agent observes and acts, and the code that runs them.

:data:`VIEWS` has the views by name. A view is a chain of Gymnasium wrappers
(:mod:`stkzoo.wrappers`); :class:`AgentChains` runs the chains of all agents of a race.
"""

import sys
from types import ModuleType

from stkzoo.views.chains import AgentChains
from stkzoo.views.plan import ViewPlan, write_rows
from stkzoo.views.registry import (
    CAMERA_VIEWS,
    VIEWS,
    View,
    ViewFactory,
    base_space,
    extras_for,
    find_view,
    full_with,
    options_of,
    views,
    views_of_agents,
)
from stkzoo.views.shipped import SHIPPED

__all__ = [
    "CAMERA_VIEWS",
    "SHIPPED",
    "VIEWS",
    "AgentChains",
    "View",
    "ViewFactory",
    "ViewPlan",
    "base_space",
    "extras_for",
    "find_view",
    "full_with",
    "options_of",
    "views",
    "views_of_agents",
    "write_rows",
]
__dir__ = __all__.copy


class _CallablePackage(ModuleType):
    """Makes the package ``stkzoo.views`` callable, because ``stkzoo.views()`` lists the views."""

    def __call__(self) -> dict[str, ViewFactory]:
        return views()


sys.modules[__name__].__class__ = _CallablePackage
