"""Drivers whose code runs on servers."""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

from stkzoo._checks import check_number, shortened
from stkzoo._reading import read_text, reading
from stkzoo._schema import Count, plain_name
from stkzoo.drivers.driver import Driver
from stkzoo.drivers.failures import printable
from stkzoo.drivers.instances import Decision, DriverRequest
from stkzoo.drivers.messages import MAX_NAME, Decided, Failed, Ready, encode_observation
from stkzoo.errors import AgentError, AgentTimeout, ConfigError, ProtocolError, RemoteError
from stkzoo.mdp.spaces import extras_of
from stkzoo.race.remote.connection import Connection, Server, ServerTimeout
from stkzoo.race.remote.protocol import Act, Open, Welcome
from stkzoo.race.remote.sockets import (
    KeyPair,
    full_address,
    new_keys,
    read_public,
    read_secret,
    zmq_module,
)

#: Additional time for a server to report that an agent exceeded its time limit [s].
_MARGIN = 5.0
#: Maximum size of a server list [bytes].
_MAX_BYTES = 1 << 20
#: Time limit for a server's reply if its agents have no time limit [s].
_TIMEOUT = 60.0


@dataclass(frozen=True, slots=True)
class ServedAgent:
    """Description of an agent on a server.

    Attributes:
        server: the server.
        number: index of the agent on the server.
        name: name of the agent; may be empty.
        source: name or path of the agent on the server.
        extras: observation entries that the agent needs beyond the ``full`` view.
    """

    server: Server
    number: Count
    name: str
    source: str
    extras: tuple[str, ...] = ()

    @classmethod
    def all_of(cls, server: Server, welcome: Welcome) -> list[ServedAgent]:
        """Returns the agents that a server lists in its welcome message."""
        return [
            cls(
                server,
                number,
                plain_name(offer.name),
                printable(offer.source, MAX_NAME),
                tuple(sorted(set(offer.extras))),
            )
            for number, offer in enumerate(welcome.agents)
        ]

    @property
    def place(self) -> str:
        """Server address and source of the agent, separated by a space."""
        return f"{self.server.address} {self.source}".strip()


class RemoteDriverGroup(AbstractContextManager["RemoteDriverGroup"]):
    """The agents of one or more servers, as drivers of races.

    >>> from stkzoo.race import run_race
    >>> with RemoteDriverGroup(["tcp://127.0.0.1:5555"]) as group:  # doctest: +SKIP
    ...     result = run_race([*group.drivers, "ai"])

    Use it in one thread only, for any number of races. Each agent has its own connection, which
    lasts for one race.

    Args:
        servers: addresses of the servers.
        agents: agents that are already known; you may omit ``servers`` then. They are
            compared with those of their servers when a race starts.
        keys: the client's keys. With ``None`` and ``server_keys``, new keys are generated, which
            only servers that allow any client accept.
        server_keys: public keys of the servers: none, one for all servers, or one per server.
        timeout: time limit for a server's reply to an observation [s]; ``None`` for the agent's
            time limit plus 5 s, or 60 s if the agent has none.
        connect_timeout: time limit for a connection [s].

    Raises:
        ConfigError: an argument is invalid, or pyzmq is not installed.
        RemoteError: a server does not reply, or is not a stkzoo server.
    """

    def __init__(
        self,
        servers: Sequence[str] = (),
        *,
        agents: Sequence[ServedAgent] = (),
        keys: KeyPair | None = None,
        server_keys: Sequence[str] = (),
        timeout: float | None = None,
        connect_timeout: float = 10.0,
    ) -> None:
        if not servers and not agents:
            raise ConfigError("no servers; name at least one, such as tcp://127.0.0.1:5555")
        if len(server_keys) not in (0, 1, len(servers)):
            raise ConfigError(
                f"{len(server_keys)} server keys for {len(servers)} servers, expected one for all, "
                "or one for each in the same order"
            )
        check_number("connect_timeout", connect_timeout, unit="seconds")
        if timeout is not None:
            check_number("timeout", timeout, unit="seconds")
        self._keys = keys or (new_keys() if server_keys else None)
        self.timeout, self.connect_timeout = timeout, connect_timeout
        keys_in_order = [*server_keys] * (len(servers) if len(server_keys) == 1 else 1)
        self._servers = [
            Server(full_address(address), key)
            for address, key in zip_longest(servers, keys_in_order)
        ]
        #: Random text by which servers recognize the connections of this group.
        self.token = secrets.token_hex(16)
        self._context = zmq_module().Context()
        try:
            #: The known agents, then the agents of each server, in order.
            self.agents: list[ServedAgent] = [*agents, *self._find_agents()]
        except BaseException:
            self.close()
            raise
        #: One driver per agent, in the same order.
        self.drivers: list[Driver] = [self._driver(agent) for agent in self.agents]

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes all connections; may be called more than once."""
        self._context.destroy(0)

    def connect(self, server: Server) -> Connection:
        """Opens a connection to a server.

        Raises:
            RemoteError: a connection to the server's address is impossible.
        """
        return Connection(self._context, server, self._keys)

    def _find_agents(self) -> list[ServedAgent]:
        deadline = time.monotonic() + self.connect_timeout
        connections = {server: self.connect(server) for server in dict.fromkeys(self._servers)}
        agents = []
        for server, connection in connections.items():
            agents += ServedAgent.all_of(server, connection.reply(deadline, "connect"))
            connection.close()
        return agents

    def _driver(self, agent: ServedAgent) -> Driver:
        start = partial(RemoteAgent, group=self, served=agent)
        return Driver(agent.name, start, agent.place, extras=frozenset(agent.extras))


class RemoteAgent:
    """An agent that runs on a server, with its own connection.

    Args:
        request: the runner's request.
        group: the group of the agent.
        served: description of the agent, which must match that of the server.

    Raises:
        AgentError: the server cannot be reached.
    """

    def __init__(
        self, request: DriverRequest, group: RemoteDriverGroup, served: ServedAgent
    ) -> None:
        self._group, self._served = group, served
        self._agent, self._start_timeout = request.agent, request.limits.start_timeout
        limit = request.limits.action_timeout
        usual_timeout = _TIMEOUT if limit is None else limit + _MARGIN
        self._timeout = usual_timeout if group.timeout is None else group.timeout
        self._paths: int | None = None
        self.is_usable = True
        self._begin = time.monotonic()
        with self._failures():
            self._connection = group.connect(served.server)
        opening = Open(
            client=group.token,
            driver=served.number,
            agent=request.agent,
            extras=sorted(extras_of(request.observation_space)),
            seed=request.seed,
            action_timeout=limit,
            start_timeout=self._start_timeout,
        )
        self._connection.request(opening, Ready, Failed)

    def ready(self) -> str:
        """Waits until the agent is ready and returns the name that it declares."""
        server = self._served.server
        with self._failures():
            patience = min(self._group.connect_timeout, self._start_timeout)
            welcome: Welcome = self._connection.reply(self._begin + patience, "connect")
            if self._served not in ServedAgent.all_of(server, welcome):
                raise ProtocolError(f"the agents of {server.address} have changed")
            deadline = self._begin + self._start_timeout + _MARGIN
            reply: Ready | Failed = self._connection.reply(deadline, "start an agent")
        if isinstance(reply, Failed):
            self.is_usable = False
            raise reply.error(self._agent, server=server.address)
        self._paths = reply.paths_used
        return reply.name

    def ask(self, observation: Any) -> None:
        """Sends the observation."""
        self._begin = time.monotonic()
        message = Act(encode_observation(observation, self._paths))
        self._connection.request(message, Decided, Failed)

    def answer(self) -> Decision:
        """Waits for the decision."""
        with self._failures():
            deadline = self._begin + self._timeout
            reply: Decided | Failed = self._connection.reply(deadline, "answer")
        seconds = self._connection.seconds
        if isinstance(reply, Failed):
            self.is_usable = reply.is_usable
            raise reply.error(self._agent, seconds, self._served.server.address)
        return reply.decision(seconds)

    def close(self) -> None:
        """Stops the agent on the server."""
        self.is_usable = False
        self._connection.close()

    @contextmanager
    def _failures(self) -> Iterator[None]:
        """Converts failures of the server to :class:`AgentError`."""
        try:
            yield
        except RemoteError as error:
            self.is_usable = False
            error_type = AgentTimeout if isinstance(error, ServerTimeout) else AgentError
            seconds = time.monotonic() - self._begin
            raise error_type(str(error), self._agent, seconds=seconds) from error


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
    with reading(f"the list of servers {path} cannot be read", "lines ADDRESS [KEY]"):
        text = read_text(path, _MAX_BYTES)
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
        tuple(str(path.parent / key) if os.path.exists(path.parent / key) else key for key in keys),
    )
