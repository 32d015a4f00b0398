"""Benchmarks behind the figures in the documentation, one command each."""
