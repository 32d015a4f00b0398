"""Benchmarks: the same races for every agent, and figures with intervals."""

__all__: list[str] = []
