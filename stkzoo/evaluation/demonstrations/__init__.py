"""Demonstrations: datasets of recorded observations and actions of drivers."""
