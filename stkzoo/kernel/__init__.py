"""The inner loops of a step, in C.

All names come from the extension ``_kernel``. Its stub ``_kernel.pyi`` documents and types them;
``tests/kernel`` compares them with implementations in NumPy (``tests/oracle``).
"""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "RECORD_SIZES",
    "ActionReader",
    "CarController",
    "EventCounter",
    "GameStepper",
    "KartObserver",
    "StepScorer",
    "TrackGraph",
    "action_mask",
    "join_rows",
    "look_around",
    "new_batch",
    "not_built",
    "observe_racing",
    "observe_standing",
    "split_batch",
    "to_polar",
    "trace_roads",
    "write_racing_view",
]
__dir__ = __all__.copy


def not_built(reason: object) -> BaseException:
    """Returns the error for an extension that is missing or out of date.

    Args:
        reason: what is wrong with it.
    """
    # Slow to import, and engine processes do not need it.
    from stkzoo._installation import pip_install, unusable

    root = Path(__file__).parents[2]
    is_checkout = (root / "setup.py").exists()
    remedy = pip_install(f'-e "{root}"') if is_checkout else "install stkzoo again"
    return unusable(f"stkzoo's C extension is not built for this code ({reason}): {remedy}")


try:
    from stkzoo.kernel._kernel import *
except ImportError as error:
    raise not_built(error) from None
if missing := {*__all__} - {*globals()}:
    raise not_built(f"it lacks {', '.join(sorted(missing))}")
