"""Converts arbitrary values from agents to values that every JSON reader accepts."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np


def json_value(value: Any) -> Any:
    """Converts a value to JSON values; never fails.

    Numpy numbers become Python numbers. JSON does not support NaN, which becomes 0, and infinite
    numbers, which become the largest finite ones. Lone surrogates, which are invalid text, become
    U+FFFD. Values of other types become strings.

    Args:
        value: the value; tuples in it stay tuples.
    """
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return _finite(float(value))
    if isinstance(value, Mapping):
        return {_text(key): json_value(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        value = value.tolist()
        return json_value(value)
    if isinstance(value, (list, tuple)):
        entries = map(json_value, value)
        return tuple(entries) if isinstance(value, tuple) else list(entries)
    return None if value is None else _text(value)


def _finite(number: float) -> float:
    if math.isnan(number):
        return 0.0
    return min(max(number, -sys.float_info.max), sys.float_info.max)


def _text(value: object) -> str:
    try:
        text = value.decode(errors="replace") if isinstance(value, bytes) else str(value)
    except Exception:  # noqa: BLE001 - a __str__ of any class
        text = f"a {type(value).__name__}"
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
