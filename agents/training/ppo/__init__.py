"""Self-play with PPO on many races at once, by choices among plans."""

__all__: list[str] = []
