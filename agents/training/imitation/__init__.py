"""Imitation of a driver (DAgger), and distillation of plans into a network."""
