"""Generators of invalid messages, and fuzzers to run by hand."""
