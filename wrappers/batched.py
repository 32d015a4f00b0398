"""The promise that lets one wrapper serve many agents at once."""

from __future__ import annotations

from collections.abc import Hashable

import gymnasium as gym

__all__ = ["BatchedWrapper"]


class BatchedWrapper(gym.utils.RecordConstructorArgs):
    """Marks a wrapper whose methods are pure functions over the last axes.

    A wrapper class that lists this class among its direct bases promises that

    - ``observation`` and ``action`` depend on nothing but their input and the
      constructor's arguments, and change neither;
    - both take any leading axes: ``(..., n)`` arrays where one agent has ``(n,)``, and
      ``(...)`` integer arrays where one agent has an ``int``;
    - the arguments are hashable and recorded with ``RecordConstructorArgs.__init__``;
    - ``reset`` and ``step`` are Gymnasium's own, and rewards are left alone.

    The promise is not inherited, because a subclass may break it: a subclass that keeps
    it lists this class again.
    """

    def batch_identity(self) -> Hashable:
        """What two wrappers have in common that do the same to the same spaces."""
        return type(self), tuple(sorted(self._saved_kwargs.items()))

    def keeps_batch_promise(self) -> bool:
        """Whether the object's own class lists :class:`BatchedWrapper`."""
        return BatchedWrapper in type(self).__bases__
