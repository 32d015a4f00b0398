"""Demonstrations: datasets of recorded observations and actions of drivers."""

__all__: list[str] = []
