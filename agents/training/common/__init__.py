"""Shared parts of the training scripts: arguments, logs, parallel races, matches."""

__all__: list[str] = []
