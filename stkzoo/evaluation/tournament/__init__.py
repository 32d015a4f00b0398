"""Tournaments: balanced races among many agents, and their ratings."""
