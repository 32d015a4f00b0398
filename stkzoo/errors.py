"""Everything that stkzoo raises on purpose.

::

    StkzooError
    ├── ConfigError (also a ValueError)   an argument or option that cannot be
    ├── AssetError                        the game's data is missing or broken
    ├── ApiOrderError                     a call that comes too early or too late
    ├── ActionError (also a ValueError)   an action that the game must not see
    ├── EngineError                       the game's process
    │   ├── EngineCrashed                 it died
    │   └── EngineTimeout                 it gave no answer in time
    ├── AgentError                        somebody's agent
    │   ├── AgentException                its wrappers (the reference's name)
    │   └── AgentTimeout                  it took too long
    └── RemoteError                       the other end of a network connection
        └── ProtocolError                 it sent what the protocol does not allow

A message says what came, what was expected and what to do about it.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "ActionError",
    "AgentError",
    "AgentException",
    "AgentTimeout",
    "ApiOrderError",
    "AssetError",
    "ConfigError",
    "EngineCrashed",
    "EngineError",
    "EngineTimeout",
    "ProtocolError",
    "RemoteError",
    "StkzooError",
    "check_whole",
    "unknown_name",
]


class StkzooError(Exception):
    """Root of all errors that stkzoo raises on purpose."""


class ConfigError(StkzooError, ValueError):
    """An argument or option has a value that cannot be."""


class AssetError(StkzooError):
    """The game's data (tracks, karts) is missing, incomplete or unusable."""


class ApiOrderError(StkzooError):
    """A method was called at a moment when it has no meaning."""


class ActionError(StkzooError, ValueError):
    """An action is outside its space, or missing.

    Attributes:
        agent: id of the agent whose action it is.
    """

    def __init__(self, message: str, agent: str) -> None:
        super().__init__(message)
        self.agent = agent

    def __reduce__(self) -> tuple[type[ActionError], tuple[str, str]]:
        return type(self), (str(self), self.agent)


class EngineError(StkzooError):
    """The game's process did not do its part.

    Attributes:
        log: the last lines that the game wrote, oldest first; empty if none.
    """

    def __init__(self, message: str, log: str = "") -> None:
        text = f"{message}\nThe game's last lines:\n{log}" if log else message
        super().__init__(text)
        self.message = message
        self.log = log

    def __reduce__(self) -> tuple[type[EngineError], tuple[str, str]]:
        return type(self), (self.message, self.log)


class EngineCrashed(EngineError):
    """The game's process died; the next ``reset`` starts a new one."""


class EngineTimeout(EngineError):
    """The game's process gave no answer in time and was ended."""


class AgentError(StkzooError):
    """Code that belongs to one agent failed.

    Attributes:
        key: id of the agent.
        trace: the traceback in the agent's own code, or the last lines that its process
            wrote; empty if there are none.
    """

    def __init__(self, message: str, key: str, trace: str = "") -> None:
        super().__init__(message)
        self.key = key
        self.trace = trace

    def __reduce__(self) -> tuple[type[AgentError], tuple[str, str, str]]:
        return type(self), (str(self), self.key, self.trace)


class AgentException(AgentError):
    """A wrapper of one agent failed, or cannot be used."""


class AgentTimeout(AgentError):
    """An agent took longer for its action than it may."""


class RemoteError(StkzooError):
    """The other end of a network connection failed."""


class ProtocolError(RemoteError):
    """The other end sent something that the protocol does not allow."""


def check_whole(name: str, value: object, low: int, high: int | None = None) -> None:
    """Checks that a value is a whole number within bounds.

    Args:
        name: what the value is for, such as ``"jobs"``.
        value: the value as it came.
        low: the lowest that can be.
        high: the highest; ``None`` for no bound.

    Raises:
        ConfigError: it is none.
    """
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if not is_whole or value < low or (high is not None and value > high):  # type: ignore[operator]
        bounds = f"of {low} or more" if high is None else f"from {low} to {high}"
        raise ConfigError(f"{name} is {value!r}, expected a whole number {bounds}")


def unknown_name(kind: str, name: object, known: Iterable[str]) -> ConfigError:
    """Builds the error for a name that is not in a list of names.

    Args:
        kind: what the name is for, such as ``"track"``.
        name: the name as it came.
        known: the names that would have been right.
    """
    known = sorted(known)
    near = difflib.get_close_matches(str(name), known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return ConfigError(f"unknown {kind} {name!r}.{hint} Known: {', '.join(known)}.")
