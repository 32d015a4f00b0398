"""Batches of races: plans, orders, and runs that resume after an interruption.

Benchmarks, tournaments and demonstrations are built on this package; what users need of it is
exported by :mod:`stkzoo.evaluation`.
"""

__all__: list[str] = []
