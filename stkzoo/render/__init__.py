"""Rendering of races: a top-down map and the game's own frames.

>>> from stkzoo.render import race_palette
>>> race_palette(2)
('#e69f00', '#56b4e9')
"""

from __future__ import annotations

from stkzoo.render.palette import race_palette, readable_on

__all__ = ["race_palette", "readable_on"]
__dir__ = __all__.copy
