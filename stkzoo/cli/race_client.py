"""``stkzoo race-client``: run a race with agents that are served elsewhere."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race.remote import RemoteDriverGroup

__all__ = ["add_parser"]

_ABOUT = """\
Runs a race like stkzoo race, with the agents of servers (stkzoo race-server) at the
wheel. Every agent of every server gets a kart, in the order of --server; the drivers
named besides run here and get the next ones. A server that is slow, dies or
misbehaves costs its own karts only.
"""

_EXAMPLES = """\
examples:
  stkzoo race-client --server 127.0.0.1:5555 --track lighthouse
  stkzoo race-client --server ada.lab:5555 --server bob.lab:5555 heuristic ai --laps 2
  stkzoo race-client --server ada.lab:5555 --server-key ada.public --secret course.secret

exit codes:
  0 all is well, 1 the race could not be run, 2 the command cannot be understood,
  3 an agent or server failed (the result tells of it), 130 interrupted
"""


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    from stkzoo.cli.race import add_race_flags

    parser = subparsers.add_parser(
        "race-client",
        help="run a race with agents that are served elsewhere",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "drivers", nargs="*", metavar="DRIVER", help="who drives besides, as in stkzoo race"
    )
    group = parser.add_argument_group("the servers")
    group.add_argument(
        "--server",
        action="append",
        required=True,
        metavar="ADDRESS",
        help="of a server, such as tcp://127.0.0.1:5555; repeatable",
    )
    group.add_argument(
        "--server-key",
        action="append",
        default=[],
        metavar="KEY",
        help="the servers' public key: a .public file or the key; once, or once for each --server",
    )
    group.add_argument("--secret", metavar="FILE", help="your own secret key (stkzoo keys new)")
    group.add_argument(
        "--timeout",
        type=float,
        metavar="SECONDS",
        help="for each of a server's answers (default: --action-timeout and 5 s)",
    )
    group.add_argument(
        "--connect-timeout",
        type=float,
        default=10.0,
        metavar="SECONDS",
        help="for a server to be there before the race (default: %(default)g)",
    )
    add_race_flags(parser)
    parser.set_defaults(run=_run, fail=parser.error, demo=False)


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.cli.race import run_races

    try:
        group = _remote_group(arguments)
    except ConfigError as error:
        arguments.fail(str(error))
    with group:
        return run_races(arguments, group.drivers)


def _remote_group(arguments: argparse.Namespace) -> RemoteDriverGroup:
    from stkzoo.race.remote import RemoteDriverGroup, read_public, read_secret

    return RemoteDriverGroup(
        arguments.server,
        keys=None if arguments.secret is None else read_secret(arguments.secret),
        server_keys=[read_public(key) for key in arguments.server_key],
        timeout=arguments.timeout,
        connect_timeout=arguments.connect_timeout,
    )
