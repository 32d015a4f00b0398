"""The network library, which not everybody needs."""

from __future__ import annotations

from types import ModuleType

from stkzoo.errors import ConfigError

__all__ = ["zmq_module"]


def zmq_module() -> ModuleType:
    """The module ``zmq``.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import zmq
    except ImportError as error:
        raise ConfigError(
            "networked races need pyzmq, which is not installed: pip install 'stkzoo[remote]'"
        ) from error
    return zmq
