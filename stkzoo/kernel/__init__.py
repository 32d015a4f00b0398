"""The step's inner loops in C.

``kernel`` is the compiled module, or ``None`` where it could not be built or where
``STKZOO_KERNEL=off`` asks for numpy. Whatever it does, numpy does too, in the place that
calls it; the tests hold the two together.
"""

from __future__ import annotations

import os
from types import ModuleType

__all__ = ["kernel"]


def _load() -> ModuleType | None:
    if os.environ.get("STKZOO_KERNEL") == "off":
        return None
    try:
        from stkzoo.kernel import _kernel
    except ImportError:
        return None
    return _kernel


kernel = _load()
