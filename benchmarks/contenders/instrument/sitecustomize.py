"""Runs at the start of Python when a benchmark puts this folder on ``PYTHONPATH``.

It opens the benchmark's clock in stkzoo's engine processes, which are separate interpreters; see
``benchmarks/contenders/timing.py``.
"""

import os
import sys
from pathlib import Path

if "STKZOO_BENCH_CLOCK" in os.environ:
    _root = str(Path(__file__).resolve().parents[3])
    sys.path.insert(0, _root)
    from benchmarks.contenders.timing import Clock, time_the_engine

    sys.path.remove(_root)
    time_the_engine(Clock(os.environ["STKZOO_BENCH_CLOCK"]))
