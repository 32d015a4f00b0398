"""Self-play with Stable-Baselines3."""

__all__: list[str] = []
