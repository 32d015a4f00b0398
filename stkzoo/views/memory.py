"""What an agent's wrappers remember from step to step, taken out and put back."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gymnasium import spaces


@dataclass(frozen=True, slots=True)
class WrapperMemory:
    """The attributes of some objects at one moment, as copies.

    Attributes:
        owners: the objects.
        attributes: their attributes, in the same order. References to an owner lead to the
            owner itself, spaces are shared, and all else is a copy.
    """

    owners: tuple[Any, ...]
    attributes: list[dict[str, Any]]

    @classmethod
    def of(cls, owners: Sequence[Any]) -> WrapperMemory:
        """What some objects remember now.

        Raises:
            Exception: an attribute cannot be copied by :func:`copy.deepcopy`.
        """
        memo = {id(owner): owner for owner in owners}
        return cls(tuple(owners), copy.deepcopy([vars(o) for o in owners], memo | _spaces(owners)))

    def check(self, others: Sequence[Any]) -> None:
        """Checks that other objects can remember this.

        Raises:
            TypeError: they are of other classes.
        """
        here, there = ([type(o) for o in objects] for objects in (self.owners, others))
        if here != there:
            raise TypeError(f"they are {_names(there)}; the state's were {_names(here)}")

    def give_to(self, others: Sequence[Any]) -> None:
        """Makes other objects, or the same ones, remember this; their spaces stay theirs.

        Args:
            others: objects of the same classes in the same order (:meth:`check`).
        """
        memo: dict[int, Any] = dict(zip(map(id, self.owners), others, strict=True))
        for owner, other in zip(self.owners, others, strict=True):
            for name, value in vars(owner).items():
                if isinstance(value, spaces.Space):
                    memo[id(value)] = vars(other).get(name, value)
        copies = copy.deepcopy(self.attributes, memo)
        for other, attributes in zip(others, copies, strict=True):
            vars(other).clear()
            vars(other).update(attributes)


def _spaces(owners: Sequence[Any]) -> dict[int, Any]:
    values = [value for owner in owners for value in vars(owner).values()]
    return {id(value): value for value in values if isinstance(value, spaces.Space)}


def _names(kinds: list[type]) -> str:
    return ", ".join(kind.__name__ for kind in kinds) or "pure functions"
