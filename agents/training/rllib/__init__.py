"""Self-play with Ray RLlib, on one machine or a cluster."""

__all__: list[str] = []
