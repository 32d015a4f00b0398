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

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from stkzoo._arguments import CommandParser, add_options, option
from stkzoo.cli._arguments import usage_errors
from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race.remote import ServerAccess


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

    server: str | None = option(action="append", metavar="ADDRESS")
    servers: str | None = option(metavar="FILE")
    server_key: str | None = option(action="append", metavar="KEY")
    secret: str | None = option(metavar="FILE")
    timeout: float | None = option(metavar="SECONDS")
    connect_timeout: float = option(10.0, metavar="SECONDS")


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    from stkzoo.cli.race import add_race_options

    parser.add_argument(
        "drivers", nargs="*", metavar="DRIVER", help="drivers that run here, as in `stkzoo race`"
    )
    add_options(parser, ServersArguments, group="servers")
    add_race_options(parser)
    parser.set_defaults(demo=False)


def server_access(arguments: argparse.Namespace) -> ServerAccess | None:
    """Returns the access to servers from the options of :class:`ServersArguments`.

    Args:
        arguments: the options.

    Returns:
        The access; ``None`` if no server is given.

    Raises:
        ConfigError: the options contradict each other, or a file cannot be read.
    """
    from stkzoo.race.remote import ServerAccess, read_servers

    servers, keys = tuple(arguments.server or ()), tuple(arguments.server_key or ())
    if arguments.servers is not None:
        if servers or keys:
            raise ConfigError("--servers lists servers and keys; leave out --server, --server-key")
        servers, keys = read_servers(arguments.servers)
    if not servers:
        return None
    secret = None if arguments.secret is None else str(Path(arguments.secret).resolve())
    return ServerAccess(servers, keys, secret, arguments.timeout, arguments.connect_timeout)


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Connects to the servers and runs the race."""
    from stkzoo.cli.race import run_races

    access = server_access(arguments)
    if access is None:
        raise ConfigError("no servers; give --server ADDRESS or --servers FILE")
    with access.connect() as group:
        return run_races(arguments, group.drivers)
