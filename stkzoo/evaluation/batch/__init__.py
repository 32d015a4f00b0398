"""Batches of races: plans, orders, and runs that resume after an interruption.

Benchmarks, tournaments and demonstrations are built on this package. :mod:`stkzoo.evaluation`
exports its public names.
"""
