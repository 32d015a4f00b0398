"""Benchmarks: the same races for every agent, and metrics with intervals."""
