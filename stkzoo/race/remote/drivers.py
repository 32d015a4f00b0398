"""Drivers whose code runs on servers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any, NoReturn

from stkzoo.errors import AgentError, AgentTimeout, ConfigError, ProtocolError, RemoteError
from stkzoo.race.drivers import Driver
from stkzoo.race.instances import Decision, DriverInstance, DriverRequest
from stkzoo.race.remote.connection import Connection, Failure, Server
from stkzoo.race.remote.keys import KeyPair
from stkzoo.race.remote.library import zmq_module
from stkzoo.race.remote.protocol import printable
from stkzoo.race.remote.sockets import full_address
from stkzoo.race.remote.spaces import space_to_data

__all__ = ["RemoteDriverGroup", "RemoteInstance"]

#: How long a server that has failed in this race may take to be there again [s].
_SECOND_CHANCE = 1.0
#: What a server may need to tell that an agent was too slow, besides the agent's time [s].
_MARGIN = 5.0
#: How long a server may take to answer if its agents may take as long as they like [s].
_TIMEOUT = 60.0


class RemoteDriverGroup:
    """The agents of some servers, as drivers of races.

    >>> from stkzoo.race import run_race
    >>> with RemoteDriverGroup(["tcp://127.0.0.1:5555"]) as group:  # doctest: +SKIP
    ...     result = run_race([*group.drivers, "ai"])

    Use it in one thread. It serves race after race; a connection lasts as long as a race.

    Args:
        servers: their addresses.
        keys: the client's own keys; ``None`` if the servers ask for none.
        server_keys: the servers' public keys: none, one for all, or one for each.
        timeout: how long a server may take for an answer [s], whatever its agents may.
        connect_timeout: how long it may take to be there [s].

    Raises:
        ConfigError: an argument cannot be, or pyzmq is not installed.
        RemoteError: a server is not there, or is no server of ours.
    """

    def __init__(
        self,
        servers: Sequence[str],
        *,
        keys: KeyPair | None = None,
        server_keys: Sequence[str] = (),
        timeout: float | None = None,
        connect_timeout: float = 10.0,
    ) -> None:
        if not servers:
            raise ConfigError("no servers; name at least one, such as tcp://127.0.0.1:5555")
        if len(server_keys) not in (0, 1, len(servers)):
            raise ConfigError(
                f"{len(server_keys)} server keys for {len(servers)} servers, expected one for all, "
                "or one for each in the same order"
            )
        for name, seconds in (("timeout", timeout), ("connect_timeout", connect_timeout)):
            if seconds is not None and not 0 < seconds < 1e9:
                raise ConfigError(f"{name} is {seconds!r}, expected seconds above 0")
        self.keys, self.timeout, self._patience = keys, timeout, connect_timeout
        one_for_each = [*server_keys] * (len(servers) if len(server_keys) == 1 else 1)
        self._servers = [
            Server(full_address(address), key)
            for address, key in zip_longest(servers, one_for_each)
        ]
        self._context = zmq_module().Context()
        self._connections: dict[Server, Connection] = {}
        self._failed: set[Server] = set()
        try:
            #: One driver for each agent of each server, in order.
            self.drivers: list[Driver] = self._find_drivers()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> RemoteDriverGroup:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends all connections; may be called twice."""
        for connection in self._connections.values():
            connection.close()
        self._connections = {}
        self._context.term()

    def connection(self, server: Server) -> Connection:
        """The connection to a server, which is a new one if there was none or it failed."""
        connection = self._connections.get(server)
        if connection is None or connection.failure:
            if connection is not None:
                connection.close()
            connection = Connection(self._context, server, self.keys)
            self._connections[server] = connection
        return connection

    def patience(self, server: Server) -> float:
        """How long to wait for a server to be there [s]."""
        return _SECOND_CHANCE if server in self._failed else self._patience

    def note(self, server: Server, is_there: bool) -> None:
        """Remembers whether a server answered, for :meth:`patience`."""
        (self._failed.discard if is_there else self._failed.add)(server)

    def flush(self) -> None:
        """Sends all that the seats were asked, to all servers, before any answer is awaited."""
        for connection in self._connections.values():
            connection.flush()

    def _find_drivers(self) -> list[Driver]:
        deadline = time.monotonic() + self._patience
        for server in self._servers:
            self.connection(server)
        drivers = []
        for server in dict.fromkeys(self._servers):
            connection = self.connection(server)
            welcome = connection.wait_welcome(deadline)
            for number, agent in enumerate(welcome["agents"]):
                name, source, sees_ground = agent
                opener = RemoteOpener(self, server, number, agent)
                where = f"{server.address} {printable(source, 100)}".strip()
                drivers.append(Driver(printable(name, 100), opener, where, sees_ground=sees_ground))
            connection.close()
        return drivers


@dataclass(frozen=True, slots=True)
class RemoteOpener:
    """Opens seats of one agent of a server.

    Attributes:
        group: the agents of all servers.
        server: where the agent is.
        number: which of the server's agents it is.
        agent: what the server said of it before the race: its name, empty if it did not know,
            where it comes from, and whether it sees the ground.
    """

    group: RemoteDriverGroup
    server: Server
    number: int
    agent: list[Any]

    def __call__(self, request: DriverRequest) -> DriverInstance:
        """Opens a seat."""
        return RemoteInstance(self, request)


class RemoteInstance:
    """An agent of a server in one race.

    Args:
        opener: which agent.
        request: what the runner asks for.

    Raises:
        AgentError: the server cannot be reached.
    """

    def __init__(self, opener: RemoteOpener, request: DriverRequest) -> None:
        self._opener, self._group = opener, opener.group
        self._agent, self._limits = request.agent, request.limits
        self._paths: int | None = None
        self.is_usable = True
        self._begin = time.monotonic()
        try:
            self._connection = self._group.connection(opener.server)
            self._seat = self._connection.open(
                driver=opener.number,
                agent=request.agent,
                observation_space=space_to_data(request.observation_space),
                action_space=space_to_data(request.action_space),
                seed=request.seed,
                action_timeout=request.limits.action_timeout,
                start_timeout=request.limits.start_timeout,
            )
        except RemoteError as error:
            raise AgentError(str(error), self._agent) from error

    def ready(self) -> str:
        """Waits until the agent can drive."""
        server, begin = self._opener.server, self._begin
        try:
            patience = min(self._group.patience(server), self._limits.start_timeout)
            welcome = self._connection.wait_welcome(begin + patience)
            self._check_same(welcome["agents"])
            deadline = begin + self._limits.start_timeout + _MARGIN
            opened = self._connection.wait_opened(self._seat, deadline)
        except RemoteError as error:
            self._lost(error)
        if isinstance(opened, Failure):
            self._failed(opened)
        self._group.note(server, is_there=True)
        self._paths = opened.paths_used
        return opened.name

    def ask(self, observation: Any) -> None:
        """Keeps the observation until all have theirs."""
        self._begin = time.monotonic()
        if self._paths is not None:
            observation = {
                key: value[: self._paths] if key.startswith("paths_") else value
                for key, value in observation.items()
            }
        try:
            self._connection.ask(self._seat, observation)
        except RemoteError as error:
            self._lost(error)

    def answer(self) -> Decision:
        """Waits for the decision."""
        self._group.flush()
        try:
            outcome = self._connection.wait_decision(self._seat, self._begin + self._time())
        except RemoteError as error:
            self._lost(error)
        if isinstance(outcome, Failure):
            self._failed(outcome)
        return outcome

    def close(self) -> None:
        """Gives the seat back."""
        self.is_usable = False
        self._connection.close_seat(self._seat)

    def _time(self) -> float:
        """How long the server may take for an answer [s]."""
        if self._group.timeout is not None:
            return self._group.timeout
        limit = self._limits.action_timeout
        return _TIMEOUT if limit is None else limit + _MARGIN

    def _check_same(self, agents: list[list[Any]]) -> None:
        """Other agents may be there since the server was asked who they are."""
        opener = self._opener
        if agents[opener.number : opener.number + 1] != [opener.agent]:
            raise ProtocolError(f"{opener.server.address} has other agents than before")

    def _lost(self, error: RemoteError) -> NoReturn:
        """Raises for a server that is gone; all its seats fail with it."""
        self.is_usable = False
        self._group.note(self._opener.server, is_there=False)
        is_late = "in time" in str(error)
        raise (AgentTimeout if is_late else AgentError)(str(error), self._agent) from error

    def _failed(self, failure: Failure) -> NoReturn:
        """Raises for an agent that the server says has failed."""
        self.is_usable = failure.is_usable
        kind = AgentTimeout if failure.is_timeout else AgentError
        raise kind(failure.text, self._agent, failure.trace)
