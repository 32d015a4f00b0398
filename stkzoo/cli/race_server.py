r"""Serve agents to races on this or other machines.

Serves agents to races that `stkzoo race-client` runs, several at once, until Ctrl-C. Each agent of
each race runs in its own process of the server, with its own wrappers. Only observations and
actions are sent over the network.

An agent is the path of a folder or zip with pystk_actor.py, or the name of a module or of one of
stkzoo's drivers; append @:Name to rename it (docs/reference/agents.md).

Examples:
  stkzoo race-server my_agent.zip             for clients on this machine
  stkzoo race-server ada.zip bob/ --address 127.0.0.1:6000
  stkzoo race-server my_agent --address '*:5555' --secret ada.secret \
      --allow course.public                   for a remote client with a key
  stkzoo race-client --server 127.0.0.1:5555  run a race with these agents
"""

from __future__ import annotations

import argparse
import logging
import signal
from dataclasses import dataclass
from typing import TYPE_CHECKING

from stkzoo._arguments import CommandParser, add_options, option, positional, values_of
from stkzoo.cli._arguments import usage_errors
from stkzoo.errors import check_whole
from stkzoo.race import RaceSettings

if TYPE_CHECKING:
    from stkzoo.race.remote import RaceServer

logger = logging.getLogger(__name__)
_SETTINGS = ("action_timeout", "start_timeout", "agent_memory", "sandbox", "inline", "adapter")


@dataclass
class RaceServerArguments:
    """Options of ``stkzoo race-server``.

    Attributes:
        agents: the agents; see above
        address: address to listen on
        threads: number of clients served at the same time
        secret: secret key of the server (see stkzoo keys new)
        allow: public key of a client, a file of keys or a folder of .public files; repeatable
        insecure: accept clients on other machines even without keys
        quiet: log only failures
    """

    agents: tuple[str, ...] = positional(metavar="AGENT")
    address: str = "tcp://127.0.0.1:5555"
    threads: int = 8
    secret: str | None = option(metavar="FILE")
    allow: str | None = option(action="append", metavar="KEY")
    insecure: bool = False
    quiet: bool = False


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    add_options(parser, RaceServerArguments)
    add_options(parser, RaceSettings, only=_SETTINGS, group="agents")


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Serves until it is stopped."""
    logging.basicConfig(
        level=logging.WARNING if arguments.quiet else logging.INFO,
        format="%(asctime)s %(message)s",
        datefmt="%H:%M:%S",
    )
    with _server(arguments) as server:
        signal.signal(signal.SIGTERM, lambda *_: server.stop())
        print(f"serving {', '.join(arguments.agents)} at {server.address}", flush=True)
        logger.info("%s", _sandbox_of(arguments))
        try:
            server.serve()
        except KeyboardInterrupt:
            logger.warning("stkzoo: server stopped")
    return 0


def _sandbox_of(arguments: argparse.Namespace) -> str:
    """Returns a description of the sandbox that protects this machine from the agents."""
    from stkzoo.drivers.sandbox import NONE, protections, sandbox_kind

    kind = NONE if arguments.inline else sandbox_kind(arguments.sandbox)
    active = () if arguments.inline else protections(kind)
    return (
        f"sandbox of agents from files: {kind}; it withholds or limits: {', '.join(active) or '-'}"
    )


def _server(arguments: argparse.Namespace) -> RaceServer:
    from stkzoo.drivers.driver import check_adapter
    from stkzoo.drivers.sandbox import say_what_is_missing
    from stkzoo.race import find_driver
    from stkzoo.race.remote import RaceServer, ServerKeys, read_publics, read_secret

    check_whole("threads", arguments.threads, 1)
    settings = RaceSettings(**values_of(arguments, RaceSettings, only=_SETTINGS))
    drivers = [
        find_driver(agent, inline=settings.inline, adapter=settings.adapter)
        for agent in arguments.agents
    ]
    check_adapter(drivers, settings.adapter)
    if not settings.inline:
        say_what_is_missing(settings.sandbox)
    keys = ServerKeys(
        own=None if arguments.secret is None else read_secret(arguments.secret),
        allowed=None if arguments.allow is None else read_publics(arguments.allow),
    )
    return RaceServer(
        drivers,
        arguments.address,
        limits=settings.limits,
        max_sessions=arguments.threads,
        keys=keys,
        insecure=arguments.insecure,
    )
