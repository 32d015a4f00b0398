"""How to reach servers, as values that a file or another process can hold."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from stkzoo._reading import Unreadable, is_there, read_text
from stkzoo.errors import ConfigError, reason, shortened
from stkzoo.race.remote.drivers import RemoteDriverGroup, ServedAgent
from stkzoo.race.remote.keys import read_public, read_secret

#: Largest size of a list of servers [bytes].
_MAX_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class ServerAccess:
    """How to reach servers; the arguments of :class:`RemoteDriverGroup`, with keys as files.

    Attributes:
        servers: their addresses.
        server_keys: their public keys, as files or text: none, one for all, or one for each.
        secret: the file of the client's own secret key; ``None`` where any client is allowed.
        timeout: time limit for a server's answer [s]; ``None`` for the agents' limit plus 5 s.
        connect_timeout: time limit for the connection [s].
    """

    servers: tuple[str, ...] = ()
    server_keys: tuple[str, ...] = ()
    secret: str | None = None
    timeout: float | None = None
    connect_timeout: float = 10.0

    def connect(self, agents: Sequence[ServedAgent] = ()) -> RemoteDriverGroup:
        """Connects to the servers, or to those of known agents when a race starts.

        Raises:
            ConfigError: a key or a value is invalid, or pyzmq is not installed.
            RemoteError: a server does not answer, or not as a stkzoo server.
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
    """The servers that a file lists: an address a line, and after it the server's public key.

    A key is a ``.public`` file, relative to the list's folder, or the key itself. Lines that start
    with ``#`` are comments.

    Returns:
        The addresses, and the keys; either all servers have a key, or none has.

    Raises:
        ConfigError: the file cannot be read, or a line is invalid.
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
