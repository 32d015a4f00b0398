"""Demonstrations: recorded observations and actions of drivers, as a data set to learn from."""

__all__: list[str] = []
