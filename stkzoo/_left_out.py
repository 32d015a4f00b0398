"""Errors for names of pystk2-gymnasium that stkzoo leaves out.

``docs/reference/differences.md`` lists these names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar


class LeftOutNames:
    """Base class of objects that lack some attributes of their namesakes in pystk2-gymnasium."""

    __slots__ = ()
    #: What to use instead, by name of the attribute.
    left_out: ClassVar[Mapping[str, str]] = {}

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(_missing(type(self).__name__, name, self.left_out))


def without_names(module: str, left_out: Mapping[str, str]) -> Callable[[str], Any]:
    """Returns a ``__getattr__`` function for a module that lacks names of its namesake.

    Args:
        module: name of the module in pystk2-gymnasium.
        left_out: what to use instead, by name.
    """

    def refuse(name: str) -> Any:
        # An import statement would replace the text of an AttributeError.
        error = ImportError if name in left_out else AttributeError
        raise error(_missing(f"module {module!r}", name, left_out))

    return refuse


def _missing(owner: str, name: str, left_out: Mapping[str, str]) -> str:
    problem = f"{owner} has no attribute {name!r}"
    instead = left_out.get(name)
    return f"{problem}, unlike in pystk2-gymnasium; {instead}" if instead else problem
