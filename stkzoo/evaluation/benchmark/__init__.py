"""Benchmarks: the same races for every agent, and figures with intervals."""
