"""Agents from files: found, loaded, and run in the program or in processes of their own."""

from __future__ import annotations

__all__: list[str] = []
