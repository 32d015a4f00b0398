r"""Run a race with agents on servers.

Runs a race like `stkzoo race`, with the agents of servers (`stkzoo race-server`). Every agent of
every server gets a kart, in the order of --server. The drivers named as arguments run in this
program and get the next karts. A server that is slow, crashes or misbehaves only affects its own
karts.

Examples:
  stkzoo race-client --server 127.0.0.1:5555 --track lighthouse
  stkzoo race-client --server ada.lab:5555 --server bob.lab:5555 heuristic ai
  stkzoo race-client --server ada.lab:5555 --server-key ada.public \
      --secret course.secret
  stkzoo race-client --servers servers.txt --secret course.secret

exit codes:
  0 success, 1 the race could not be run, 2 invalid command line, 3 an agent
  or server failed (the result has the error), 130 interrupted
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo._arguments import option, options_of, positional
from stkzoo.cli.race import RacesArguments, run_races
from stkzoo.errors import ConfigError
from stkzoo.race.remote import ServerAccess, read_servers


@dataclass
class ServersArguments:
    """Options of the connection to servers.

    Attributes:
        server: address of a server, such as 127.0.0.1:5555; repeatable
        servers: list of servers, one ADDRESS [KEY] per line, instead of --server
        server_key: public key of the servers, or a .public file; give it once, or once for each
            --server
        secret: your secret key (see stkzoo keys new)
        timeout: time limit for a server's reply (default: --action-timeout plus 5 s)
        connect_timeout: time limit for the connection to a server
    """

    server: tuple[str, ...] | None = option(action="append", metavar="ADDRESS")
    servers: str | None = option(metavar="FILE")
    server_key: tuple[str, ...] | None = option(action="append", metavar="KEY")
    secret: str | None = option(metavar="FILE")
    timeout: float | None = option(metavar="SECONDS")
    connect_timeout: float = option(10.0, metavar="SECONDS")


@dataclass
class RaceClientArguments(RacesArguments):
    """Options of ``stkzoo race-client``."""

    drivers: tuple[str, ...] = positional((), help="drivers that run here, as in `stkzoo race`")
    servers: ServersArguments = options_of(ServersArguments, group="servers")


def server_access(arguments: ServersArguments) -> ServerAccess | None:
    """Returns the access to servers.

    Args:
        arguments: the options.

    Returns:
        The access; ``None`` if no server is given.

    Raises:
        ConfigError: the options contradict each other, or a file cannot be read.
    """
    servers, keys = arguments.server or (), arguments.server_key or ()
    if arguments.servers is not None:
        if servers or keys:
            raise ConfigError("--servers lists servers and keys; leave out --server, --server-key")
        servers, keys = read_servers(arguments.servers)
    if not servers:
        return None
    secret = None if arguments.secret is None else str(Path(arguments.secret).resolve())
    return ServerAccess(servers, keys, secret, arguments.timeout, arguments.connect_timeout)


def run(arguments: RaceClientArguments, **outputs: Any) -> int:
    """Connects to the servers and runs the race.

    Args:
        arguments: the options.
        **outputs: as for :func:`stkzoo.cli.race.run_races`.
    """
    access = server_access(arguments.servers)
    if access is None:
        raise ConfigError("no servers; give --server ADDRESS or --servers FILE")
    with access.connect() as group:
        return run_races(arguments, [*group.drivers, *arguments.drivers], **outputs)
