"""How long work tells what it is doing."""

from __future__ import annotations

__all__ = ["Progress"]


class Progress:
    """A listener that ignores everything; the command line draws bars with its own.

    Work is a sequence of stages. Each begins with :meth:`begin` and ends when the
    next one begins.
    """

    def begin(self, stage: str, total: int | None = None) -> None:
        """A stage starts.

        Args:
            stage: what is done now, in a few words.
            total: amount of work [bytes], ``None`` if unknown.
        """

    def reach(self, done: int) -> None:
        """``done`` [bytes] of the stage are behind us."""

    def note(self, text: str) -> None:
        """Something worth a line happened."""
