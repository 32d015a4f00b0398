"""The cost of an input to a reader: peak memory and CPU time.

``tracemalloc`` counts all bytes that Python, NumPy, zlib and lzma allocate, even if they are freed
again. It adds 20 us per message and 0.1 ms per result, which is 5 minutes for a million inputs. The
process's resident memory (``VmHWM`` after ``clear_refs``) would cost 0.04 ms, but it misses
allocations that fit into previously freed memory, and 1 MiB usually does.
"""

from __future__ import annotations

import gc
import time
import tracemalloc

from tests.chaos.targets import Target

__all__ = ["feed_measured"]

#: CPU time that one input may take [s].
_MAX_SECONDS = 1.0
_ATTEMPTS = 3


def feed_measured(target: Target, data: bytes) -> None:
    """Feeds an input to a target and checks its cost.

    An input that exceeds a limit is measured again, because garbage collection or the growth of one
    of Python's internal tables may have coincided with it.

    Raises:
        AssertionError: each attempt took too much memory or time.
        Exception: what the target raises.
    """
    limit = target.max_memory(len(data))
    for _ in range(_ATTEMPTS):
        memory, seconds = _measured(target, data)
        if memory <= limit and seconds <= _MAX_SECONDS:
            break
        gc.collect()
    else:
        raise AssertionError(
            f"{len(data)} bytes took {memory} bytes of memory and {seconds:.2f} s, "
            f"expected at most {limit} bytes and {_MAX_SECONDS:g} s"
        )
    if target.read is not None:
        target.feed(data)


def _measured(target: Target, data: bytes) -> tuple[int, float]:
    """Returns the peak memory above the start [bytes] and the CPU time of all threads [s]."""
    tracemalloc.start()
    begin = time.process_time()
    try:
        (target.read or target.feed)(data)
    finally:
        seconds, peak = time.process_time() - begin, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return peak, seconds
