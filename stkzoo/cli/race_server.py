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

import logging
import signal
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import option, options_of, positional
from stkzoo._checks import check_whole
from stkzoo.drivers.sandbox import NONE, protections, sandbox_kind, say_what_is_missing
from stkzoo.race import RaceSettings, find_driver
from stkzoo.race.remote import RaceServer, ServerKeys, read_publics, read_secret

logger = logging.getLogger(__name__)
#: Settings of a race that a server decides.
SETTINGS = ("action_timeout", "start_timeout", "agent_memory", "sandbox", "inline", "adapter")


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
    allow: tuple[str, ...] | None = option(action="append", metavar="KEY")
    insecure: bool = False
    quiet: bool = False
    settings: dict[str, Any] = options_of(RaceSettings, only=SETTINGS, group="agents")


def run(arguments: RaceServerArguments) -> None:
    """Serves until it is stopped."""
    logging.basicConfig(
        level=logging.WARNING if arguments.quiet else logging.INFO,
        format="%(asctime)s %(message)s",
        datefmt="%H:%M:%S",
    )
    settings = RaceSettings(**arguments.settings)
    with _server(arguments, settings) as server:
        signal.signal(signal.SIGTERM, lambda *_: server.stop())
        print(f"serving {', '.join(arguments.agents)} at {server.address}", flush=True)
        logger.info("%s", _sandbox_of(settings))
        try:
            server.serve()
        except KeyboardInterrupt:
            logger.warning("stkzoo: server stopped")


def _sandbox_of(settings: RaceSettings) -> str:
    """Returns a description of the sandbox that protects this machine from the agents."""
    sandbox = NONE if settings.inline else sandbox_kind(settings.sandbox)
    active = ", ".join(() if settings.inline else protections(sandbox)) or "-"
    return f"sandbox of agents from files: {sandbox}; it withholds or limits: {active}"


def _server(arguments: RaceServerArguments, settings: RaceSettings) -> RaceServer:
    check_whole("threads", arguments.threads, 1)
    drivers = [
        find_driver(agent, inline=settings.inline, adapter=settings.adapter)
        for agent in arguments.agents
    ]
    if not settings.inline:
        say_what_is_missing(settings.sandbox)
    keys = ServerKeys(
        pair=None if arguments.secret is None else read_secret(arguments.secret),
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
