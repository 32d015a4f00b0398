"""Shared parts of the training scripts: arguments, logs, parallel races, matches."""
