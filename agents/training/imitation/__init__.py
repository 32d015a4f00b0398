"""Imitation of a driver (DAgger), and distillation of plans into a network."""

__all__: list[str] = []
