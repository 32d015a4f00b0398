"""All errors that stkzoo raises on purpose.

::

    StkzooError
    ├── ConfigError (also a ValueError)   an argument or option is invalid
    │   └── ArgumentNameError (also a TypeError)   a keyword argument is unknown
    ├── AssetError                        the game's data is missing or broken
    ├── ApiOrderError                     a method was called too early or too late
    ├── ActionError (also a ValueError)   an action is invalid; the race did not advance
    ├── EngineError                       the game's process failed
    │   ├── EngineCrashed                 the game's process ended unexpectedly
    │   └── EngineTimeout                 the game's process did not answer in time
    ├── AgentError                        an agent's own code failed
    │   ├── AgentException                a wrapper of an agent failed (pystk2-gymnasium's name)
    │   └── AgentTimeout                  an agent took too long
    └── RemoteError                       the other end of a network connection failed
        └── ProtocolError                 the other end sent an invalid message

An error text says what was found, what was expected and what to do. Every error can be pickled,
and constructed from its text alone.
"""

from __future__ import annotations

__all__ = [
    "ActionError",
    "AgentError",
    "AgentException",
    "AgentTimeout",
    "ApiOrderError",
    "ArgumentNameError",
    "AssetError",
    "ConfigError",
    "EngineCrashed",
    "EngineError",
    "EngineTimeout",
    "ProtocolError",
    "RemoteError",
    "StkzooError",
]

#: Maximum length of the first line of an error text [characters].
MAX_LINE = 200


class StkzooError(Exception):
    """Base class of all errors that stkzoo raises on purpose."""


class ConfigError(StkzooError, ValueError):
    """An argument or option is invalid."""


class ArgumentNameError(ConfigError, TypeError):
    """A keyword argument is unknown. Libraries that try arguments out expect a ``TypeError``."""


class AssetError(StkzooError):
    """The game's data (tracks, karts) is missing or broken."""


class ApiOrderError(StkzooError):
    """A method was called too early or too late."""


class ActionError(StkzooError, ValueError):
    """An action is outside its space, or missing. The race did not advance.

    Attributes:
        agent: id of the agent; empty if unknown.
    """

    def __init__(self, message: str, agent: str = "") -> None:
        super().__init__(message)
        self.agent = agent


class EngineError(StkzooError):
    """The game's process failed.

    Attributes:
        message: the text without the log.
        log: last lines of the game's output, oldest first; may be empty.
    """

    def __init__(self, message: str, log: str = "") -> None:
        text = f"{message}\nLast output of the game:\n{log}" if log else message
        super().__init__(text)
        self.message = message
        self.log = log


class EngineCrashed(EngineError):
    """The game's process ended unexpectedly. The next ``reset`` starts a new one."""


class EngineTimeout(EngineError):
    """The game's process did not answer in time and was ended."""


class AgentError(StkzooError):
    """An agent's own code failed.

    Attributes:
        key: id of the agent; empty if unknown.
        trace: traceback in the agent's code, or the last output of its process; may be empty.
        seconds: duration of the failed decision [s]; 0 if unknown.
    """

    def __init__(self, message: str, key: str = "", trace: str = "", seconds: float = 0.0) -> None:
        super().__init__(message)
        self.key = key
        self.trace = trace
        self.seconds = seconds


class AgentException(AgentError):
    """A wrapper of an agent failed, or cannot be used."""


class AgentTimeout(AgentError):
    """An agent exceeded the time limit for its action."""


class RemoteError(StkzooError):
    """The other end of a network connection failed."""


class ProtocolError(RemoteError):
    """The other end of a network connection sent an invalid message."""


def reason(error: Exception) -> str:
    """Returns why a file or address cannot be used, without its name or an error number."""
    return (getattr(error, "strerror", None) or str(error)).partition(" (while ")[0]
