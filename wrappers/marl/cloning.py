"""Clones of a race with its wrappers."""

from __future__ import annotations

import contextlib
import copy
from typing import TYPE_CHECKING, Any

from pettingzoo.utils import BaseParallelWrapper

if TYPE_CHECKING:
    from typing_extensions import Self


class ClonableWrapper(BaseParallelWrapper[str, Any, Any]):
    """A wrapper of a race that its clones keep, because it has no state between two steps."""

    def clone(self) -> Self:
        """Returns this wrapper around a clone of its environment.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.clone`.
        """
        race = self.env.clone()
        twin = copy.copy(self)
        own = {name: value for name, value in vars(self).items() if name != "env"}
        twin.__dict__.update(copy.deepcopy(own), env=race)
        return twin

    def lookahead(self) -> contextlib.closing[Self]:
        """Yields a clone for trying actions and closes it at the end."""
        return contextlib.closing(self.clone())

    def follow(self, other: Self) -> None:
        """Continues from the current state of another environment with equal wrappers.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.follow`.
        """
        self.env.follow(other.env)
