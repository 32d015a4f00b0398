"""Imitation of a teacher (DAgger), and distillation of plans into a network."""
