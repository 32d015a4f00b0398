"""Imitation of a driver: behavior cloning and DAgger."""
