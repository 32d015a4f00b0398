"""Runs code written for ``pystk2_gymnasium`` on stkzoo.

Import this module before the original package::

    import stkzoo.compat
    from pystk2_gymnasium.envs import AgentSpec, STKRaceEnv

Then ``import pystk2_gymnasium``, its submodules and its environment ids resolve to stkzoo, even if
the original package is installed. All environments of the program clip actions to their spaces and
ignore unknown keys, as the original package does, and log the first one of an agent in a race.
``docs/reference/differences.md`` lists the intended differences.
"""

from __future__ import annotations

import sys

from stkzoo._pystk2_gymnasium import modules
from stkzoo.env.ids import register_gymnasium_ids
from stkzoo.views.agent_chain import AgentChain

__all__ = ["install"]


def install() -> None:
    """Makes ``pystk2_gymnasium``, its submodules and its environment ids resolve to stkzoo.

    Names that other code has already imported from the original package keep referring to it; a
    warning reports this once.
    """
    for name in list(sys.modules):
        if name.partition(".")[0] == "pystk2_gymnasium":
            del sys.modules[name]
    sys.modules.update(modules())
    register_gymnasium_ids()
    AgentChain.is_strict = False


install()
