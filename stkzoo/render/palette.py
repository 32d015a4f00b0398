"""Colors of karts, shared by the map, videos, the live page and plots."""

from __future__ import annotations

import colorsys
from functools import lru_cache

#: Red, green and blue, 0 to 255.
Color = tuple[int, int, int]

#: Okabe and Ito's color-blind safe palette (https://jfly.uni-koeln.de/color/), ordered so that
#: neighbors differ most.
_FIRST = (
    *("#e69f00", "#56b4e9", "#009e73", "#f0e442"),
    *("#0072b2", "#d55e00", "#cc79a7", "#f5f5f5"),
)
#: Hue step (golden ratio) that keeps new colors away from all earlier ones.
_GOLDEN_TURN = 0.618034
_LEVELS = ((0.95, 0.55), (0.70, 0.75), (1.0, 0.30))


@lru_cache(maxsize=64)
def race_palette(number: int) -> tuple[str, ...]:
    """Returns distinct colors as ``"#rrggbb"``.

    The first eight are safe for color-blind readers. Color ``i`` does not depend on ``number``.

    Args:
        number: number of colors: one per agent in agent order, then the other karts.
    """
    return (_FIRST + tuple(_further(index) for index in range(number - len(_FIRST))))[:number]


def _further(index: int) -> str:
    value, saturation = _LEVELS[index % len(_LEVELS)]
    parts = colorsys.hsv_to_rgb((0.02 + index * _GOLDEN_TURN) % 1.0, saturation, value)
    return "#" + "".join(f"{round(255 * part):02x}" for part in parts)


@lru_cache(maxsize=512)
def rgb(color: str) -> Color:
    """Converts ``"#rrggbb"`` to three numbers from 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def readable_on(color: str) -> str:
    """Returns black or white, whichever has more contrast on a color."""
    red, green, blue = rgb(color)
    return "#10141a" if 0.299 * red + 0.587 * green + 0.114 * blue > 140 else "#ffffff"
