"""Tournaments: balanced races among many agents, and their ratings."""

__all__: list[str] = []
