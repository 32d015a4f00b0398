"""Runs code that was written for ``pystk2_gymnasium`` on stkzoo.

Importing this module makes ``import pystk2_gymnasium`` and its submodules resolve to
stkzoo's own, if the real one is not installed. What differs on purpose stands in
``docs/differences.md``.

>>> import stkzoo.compat
>>> from pystk2_gymnasium.envs import AgentSpec, STKRaceEnv
"""

from __future__ import annotations

import importlib
import importlib.util
import sys

__all__ = ["install"]

_NAME = "pystk2_gymnasium"
_SUBMODULES = ("definitions", "envs", "stk_wrappers", "utils", "vecenv", "wrappers")


def install(*, replace: bool = False) -> bool:
    """Makes ``pystk2_gymnasium`` resolve to stkzoo where nothing else provides it.

    Args:
        replace: also where the real one is installed; code that has imported the real
            one already keeps it.

    Returns:
        Whether it resolves to stkzoo now.
    """
    present = sys.modules.get(_NAME)
    if present is not None and present.__name__.startswith(__name__):
        return True
    if not replace and (present is not None or importlib.util.find_spec(_NAME) is not None):
        return False
    ours = f"{__name__}.{_NAME}"
    sys.modules[_NAME] = importlib.import_module(ours)
    for submodule in _SUBMODULES:
        sys.modules[f"{_NAME}.{submodule}"] = importlib.import_module(f"{ours}.{submodule}")
    return True


install()
