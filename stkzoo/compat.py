"""Runs code written for ``pystk2_gymnasium`` on stkzoo.

After you import this module, ``import pystk2_gymnasium``, its submodules and its environment ids
resolve to stkzoo, even if the original package is installed. Import this module before the
original package. All environments of the program then clip actions to their spaces and ignore
unknown keys, as the original package does, and log the first one of an agent in a race.
``docs/reference/differences.md`` lists the intended differences.

>>> import stkzoo.compat
>>> from pystk2_gymnasium.envs import AgentSpec, STKRaceEnv
"""

from __future__ import annotations

import sys

from stkzoo._pystk2_gymnasium import modules
from stkzoo.env.ids import register_gymnasium_ids
from stkzoo.views.agent_chain import AgentChain

__all__ = ["install"]

_NAME = "pystk2_gymnasium"


def install(*, replace: bool = True) -> bool:
    """Makes ``pystk2_gymnasium``, its submodules and its environment ids resolve to stkzoo.

    Args:
        replace: also replace the original package if it is already imported. Names that other code
            has imported from it keep referring to the original; a warning reports this once.

    Returns:
        Whether ``pystk2_gymnasium`` resolves to stkzoo now.
    """
    ours = modules()
    present = sys.modules.get(_NAME, ours[_NAME])
    if present is not ours[_NAME] and not replace:
        return False
    for name in list(sys.modules):
        if name.partition(".")[0] == _NAME:
            del sys.modules[name]
    sys.modules.update(ours)
    register_gymnasium_ids()
    AgentChain.is_strict = False
    return True


install()
