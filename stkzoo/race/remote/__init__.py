"""Races with agents on other machines: agent servers, and drivers that connect to them.

``docs/reference/protocol.md`` describes the messages. They contain no pickled data. An invalid
message from a client or a server affects only its own part of the race.
"""

from __future__ import annotations

from stkzoo.race.remote.drivers import (
    RemoteDriverGroup,
    ServedAgent,
    ServerAccess,
    read_servers,
)
from stkzoo.race.remote.server import RaceServer
from stkzoo.race.remote.sockets import (
    KeyPair,
    ServerKeys,
    new_key_files,
    new_keys,
    read_public,
    read_publics,
    read_secret,
)

__all__ = [
    "KeyPair",
    "RaceServer",
    "RemoteDriverGroup",
    "ServedAgent",
    "ServerAccess",
    "ServerKeys",
    "new_key_files",
    "new_keys",
    "read_public",
    "read_publics",
    "read_secret",
    "read_servers",
]
__dir__ = __all__.copy
