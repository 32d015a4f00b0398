"""Access to servers, as plain values that can be stored or passed to another process."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stkzoo._reading import Unreadable, is_there, read_text
from stkzoo.errors import ConfigError, reason, shortened
from stkzoo.race.remote.drivers import RemoteDriverGroup, ServedAgent
from stkzoo.race.remote.keys import read_public, read_secret

#: Maximum size of a server list [bytes].
_MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ServerAccess:
    """Access to servers: the arguments of :class:`RemoteDriverGroup`, with keys as files.

    Attributes:
        servers: addresses of the servers.
        server_keys: public keys of the servers, as files or text: none, one for all servers, or one
            per server.
        secret: file of the client's secret key; ``None`` if the servers allow any client.
        timeout: time limit for a server's reply [s]; ``None`` for the agents' time limit plus 5 s.
        connect_timeout: time limit for a connection [s].
    """

    servers: tuple[str, ...] = ()
    server_keys: tuple[str, ...] = ()
    secret: str | None = None
    timeout: float | None = None
    connect_timeout: float = 10.0

    def connect(self, agents: Sequence[ServedAgent] = ()) -> RemoteDriverGroup:
        """Connects to the servers.

        Args:
            agents: agents that are already known; see :class:`RemoteDriverGroup`.

        Raises:
            ConfigError: a key or a value is invalid, or pyzmq is not installed.
            RemoteError: a server does not reply, or is not a stkzoo server.
        """
        return RemoteDriverGroup(
            self.servers,
            agents=agents,
            keys=None if self.secret is None else read_secret(self.secret),
            server_keys=[read_public(key) for key in self.server_keys],
            timeout=self.timeout,
            connect_timeout=self.connect_timeout,
        )


def read_servers(file: str | os.PathLike[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Reads a server list. Each line contains an address and optionally the server's public key.

    A key is the path of a ``.public`` file, relative to the list's folder, or the key itself. Lines
    that start with ``#`` are comments.

    Returns:
        The addresses and the keys. Either all servers have a key, or none has.

    Raises:
        ConfigError: the file cannot be read or lists no servers, a line is invalid, or only some
            servers have a key.
    """
    path = Path(file).expanduser()
    try:
        text = read_text(path, _MAX_BYTES)
    except (OSError, Unreadable) as error:
        raise ConfigError(f"the list of servers {path} cannot be read: {reason(error)}") from error
    lines = [line.split() for line in text.splitlines() if line.strip() and line[0] != "#"]
    for words in lines:
        if len(words) > 2:
            line = shortened(" ".join(words))
            raise ConfigError(f"{path} has the line {line}, expected ADDRESS [KEY]")
    if not lines:
        raise ConfigError(f"{path} lists no servers; write a line ADDRESS [KEY] for each")
    if len({len(words) for words in lines}) > 1:
        raise ConfigError(f"{path} has a key for some servers only; write one after each address")
    keys = (words[1] for words in lines if len(words) == 2)
    return (
        tuple(words[0] for words in lines),
        tuple(str(path.parent / key) if is_there(path.parent / key) else key for key in keys),
    )
