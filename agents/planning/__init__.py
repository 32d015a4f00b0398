"""The planner of the heuristic and the learned drivers, for any number of karts at once.

Ten times per second it lists what each kart can do in the next two seconds (:mod:`.plans`): which
lane to drive in, whether to brake, when to drift and for how long. It simulates all plans on the
road ahead, in arcs or with a network that has learned how karts move (:mod:`.motion`), and assigns
each a worth in meters (:mod:`.worth`). Boosts and items increase the worth; the edge of the road
and slower karts ahead decrease it. :class:`PlanDriver` keeps the karts' state between steps and
converts a policy's choices among the best plans to controls.

The inner loops are in the C extension ``_planning``, typed by ``_planning.pyi``; NumPy versions in
``tests/oracle`` check them.

The planner was developed on the training tracks of :mod:`stkzoo.tracks` only. An evolution strategy
tuned most of its parameters there (``benchmarks/results/research-log.md``).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo._imports import lazy_names
from stkzoo.kernel import not_built

try:
    from . import _planning  # noqa: F401 - tells how to build it before another import fails
except ImportError as error:
    raise not_built(error) from None

__all__ = ["BoolArray", "FloatArray", "IntArray"]
__dir__ = __all__.copy
__getattr__ = lazy_names(__name__)

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
