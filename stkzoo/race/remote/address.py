"""Addresses of servers."""

from __future__ import annotations

import ipaddress
import re

from stkzoo.errors import ConfigError

__all__ = ["DEFAULT_ADDRESS", "full_address", "is_local"]

#: Where a server listens if nobody says otherwise.
DEFAULT_ADDRESS = "tcp://127.0.0.1:5555"

_DEFAULT_PORT = "5555"
_TCP = re.compile(r"(?P<host>\[[0-9a-fA-F:.%]+\]|[A-Za-z0-9_.-]+|\*)(:(?P<port>\d{1,5}|\*))?")


def full_address(text: str) -> str:
    """An address as ZeroMQ wants it.

    Args:
        text: ``tcp://host:port``, ``host:port``, ``host`` or ``ipc:///path``. A server's host
            may be ``*`` for all of the machine's, and its port ``*`` for any that is free.

    Raises:
        ConfigError: it is none of these.
    """
    if text.startswith("ipc://") and len(text) > len("ipc://"):
        return text
    match = _TCP.fullmatch(text.removeprefix("tcp://"))
    if match is None or not _is_port(match["port"] or _DEFAULT_PORT):
        raise ConfigError(f"address {text!r}, expected one such as {DEFAULT_ADDRESS}")
    host = "127.0.0.1" if match["host"] == "localhost" else match["host"]
    return f"tcp://{host}:{match['port'] or _DEFAULT_PORT}"


def _is_port(text: str) -> bool:
    return text == "*" or 0 < int(text) < 65536


def is_local(address: str) -> bool:
    """Whether only programs of the same machine can reach a listening address."""
    if address.startswith("ipc://"):
        return True
    host = address.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
