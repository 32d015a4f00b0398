"""How a check says that it did not pass."""

from __future__ import annotations

from stkzoo.errors import StkzooError

__all__ = ["CheckFailed", "NotApplicable"]


class CheckFailed(StkzooError):
    """The environment breaks the rule; the text says where, and what was expected."""


class NotApplicable(StkzooError):
    """The environment has nothing that the check could look at; the text says what."""
