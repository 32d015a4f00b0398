"""The names of ``pystk2_gymnasium``, provided by stkzoo."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType

from stkzoo._pystk2_gymnasium import definitions, envs, stk_wrappers, utils, vecenv, wrappers

__version__ = "0.10.0"

#: The package itself has the names of these modules too.
_NAMES = {
    name: value
    for module in (definitions, stk_wrappers, vecenv, wrappers)
    for name, value in vars(module).items()
    if not name.startswith("_")
}
globals().update(_NAMES)

__all__ = ["definitions", "envs", "stk_wrappers", "utils", "vecenv", "wrappers", *_NAMES]
__dir__ = __all__.copy


def __getattr__(name: str) -> ModuleType:
    if name in ("cli", "pystk_process"):
        return import_module(f"{__name__}.{name}")  # raises an error that says what to use instead
    raise AttributeError(f"module 'pystk2_gymnasium' has no attribute {name!r}")


def modules() -> dict[str, ModuleType]:
    """This package and its modules, by the names that they have in ``pystk2_gymnasium``."""
    return {
        name.replace(__name__, "pystk2_gymnasium", 1): module
        for name, module in list(sys.modules.items())
        if f"{name}.".startswith(f"{__name__}.")
    }
