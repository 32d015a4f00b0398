"""Runs code that was written for ``pystk2_gymnasium`` on stkzoo.

Importing this module makes ``import pystk2_gymnasium``, its submodules and its ids resolve to
stkzoo's own, also where the real one is installed. Import it before the real one. What differs
on purpose is listed in ``docs/reference/differences.md``.

>>> import stkzoo.compat
>>> from pystk2_gymnasium.envs import AgentSpec, STKRaceEnv
"""

from __future__ import annotations

import sys

from stkzoo._pystk2_gymnasium import modules
from stkzoo.env.ids import register_gymnasium_ids

__all__ = ["install"]

_NAME = "pystk2_gymnasium"


def install(*, replace: bool = True) -> bool:
    """Makes ``pystk2_gymnasium``, with its submodules and ids, resolve to stkzoo.

    Args:
        replace: also where the real one has been imported. Names that code has imported from it
            stay the real ones; a warning says so once.

    Returns:
        Whether it resolves to stkzoo now.
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
    return True


install()
