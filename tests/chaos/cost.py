"""What a reader's input costs: the peak of its memory, and its CPU time.

``tracemalloc`` counts each byte that Python, numpy, zlib and lzma allocate, and sees what is
freed again. It adds 20 us to a message and 0.1 ms to a result, 5 minutes to a million inputs. The
process's resident memory (``VmHWM`` after ``clear_refs``) costs 0.04 ms, but hides what fits into
memory that was freed before, as 1 MiB usually does.
"""

from __future__ import annotations

import gc
import time
import tracemalloc
from dataclasses import dataclass

from tests.chaos.targets import Target

__all__ = ["MAX_SECONDS", "Cost", "feed_measured"]

#: CPU time that one input may take [s].
MAX_SECONDS = 1.0
_ATTEMPTS = 3


@dataclass(frozen=True, slots=True)
class Cost:
    """What one input took.

    Attributes:
        memory: peak of the memory above that at the start [bytes].
        seconds: CPU time of all threads, with the cost of measuring [s].
    """

    memory: int
    seconds: float


def feed_measured(target: Target, data: bytes) -> Cost:
    """Feeds a target some bytes.

    An input above a bound is measured again: a collection of garbage, or a table of Python's own
    that grows, may coincide with it.

    Raises:
        AssertionError: it took too much memory or time, each time.
        Exception: what the target raises.
    """
    limit = target.max_memory(len(data))
    for _ in range(_ATTEMPTS):
        cost = _measured(target, data)
        if cost.memory <= limit and cost.seconds <= MAX_SECONDS:
            break
        gc.collect()
    else:
        raise AssertionError(
            f"{len(data)} bytes took {cost.memory} bytes of memory and {cost.seconds:.2f} s, "
            f"expected at most {limit} bytes and {MAX_SECONDS:g} s"
        )
    if target.read is not None:
        target.feed(data)
    return cost


def _measured(target: Target, data: bytes) -> Cost:
    tracemalloc.start()
    begin = time.process_time()
    try:
        (target.read or target.feed)(data)
    finally:
        seconds, peak = time.process_time() - begin, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return Cost(peak, seconds)
