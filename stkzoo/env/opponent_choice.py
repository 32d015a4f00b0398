"""The ``opponents`` argument: drivers for karts that are not agents."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from stkzoo._checks import shortened
from stkzoo.drivers import Driver, OpponentPool
from stkzoo.drivers.code import AgentCode
from stkzoo.drivers.failures import in_words
from stkzoo.drivers.files import name_of_files
from stkzoo.drivers.pool import as_driver
from stkzoo.errors import AgentError, ConfigError


class OpponentChoice:
    """The ``opponents`` argument, and the loaded code of in-process drivers.

    Parallel races share one object, so that karts with the same driver are computed together.

    Args:
        choice: a pool, from which every kart that is not an agent draws its driver; or a list with
            one entry per opponent: a pool, or any value that :func:`~stkzoo.drivers.pool.as_driver`
            accepts. A mapping from drivers to weights defines a pool.

    Raises:
        ConfigError: the choice is invalid, or the opponents require different difficulties.
    """

    def __init__(self, choice: object) -> None:
        choice = OpponentPool(choice) if isinstance(choice, Mapping) else choice
        if isinstance(choice, str) or not isinstance(choice, (Sequence, OpponentPool)):
            raise ConfigError(
                f"opponents is {shortened(choice, 200)}, expected a list such as "
                "['pretrained:ace', 'ai:3'], or an OpponentPool"
            )
        self._pool = choice if isinstance(choice, OpponentPool) else None
        members = [] if isinstance(choice, OpponentPool) else list(choice)
        keys = [member if isinstance(member, str) else id(member) for member in members]
        by_key = {key: _driver_or_pool(m) for key, m in zip(keys, members, strict=True)}
        self._members = [by_key[key] for key in keys]  # shared, so that equal drivers run together
        self._codes: dict[Driver, AgentCode | AgentError] = {}
        self.level()
        self._resources = ExitStack()
        weakref.finalize(self, self._resources.close)

    @classmethod
    def of(cls, choice: object) -> OpponentChoice:
        """Converts an argument to an :class:`OpponentChoice`; returns existing ones unchanged.

        Raises:
            ConfigError: the argument is invalid.
        """
        return choice if isinstance(choice, cls) else cls(choice)

    def count(self, num_agents: int | None, num_kart: int) -> int:
        """Returns the number of opponents.

        Args:
            num_agents: number of agents; ``None`` if all other karts are agents.
            num_kart: number of karts.

        Raises:
            ConfigError: agents and opponents do not fit the number of karts.
        """
        if self._pool is None:
            count = len(self._members)
        elif num_agents is None:
            raise ConfigError(
                "a pool drives all karts that are not agents; set the number of agents, such as "
                "agents=1, or pass a list, such as opponents=[pool]"
            )
        else:
            count = num_kart - num_agents
        if (1 if num_agents is None else num_agents) + count > num_kart:
            agents = "an agent" if num_agents in (None, 1) else f"{num_agents} agents"
            raise ConfigError(
                f"{agents} and {count} opponents for {num_kart} karts; raise num_kart or leave "
                "some out"
            )
        return count

    def members(self, count: int) -> Sequence[Driver | OpponentPool]:
        """Returns a driver or a pool for each of a number of opponents."""
        return self._members if self._pool is None else [self._pool] * count

    def level(self, difficulty: int | None = None) -> int | None:
        """Returns the difficulty that the opponents require, except those drawn from pools.

        Args:
            difficulty: difficulty requested in ``reset``, if any.

        Returns:
            The difficulty; ``None`` if none is required.

        Raises:
            ConfigError: the opponents require another difficulty.
        """
        drivers = [member for member in self._members if isinstance(member, Driver)]
        asked = [difficulty, *(driver.difficulty for driver in drivers)]
        levels = {level for level in asked if level is not None}
        if len(levels) > 1:
            raise ConfigError(
                f"opponents and options require the difficulties {sorted(levels)}, but the game's "
                "AI has one level per race; choose one"
            )
        return levels.pop() if levels else None

    def code(self, driver: Driver) -> AgentCode:
        """Returns the code of an in-process driver, and loads it on first use.

        Raises:
            AgentError: the code cannot be loaded.
        """
        if driver not in self._codes:
            assert driver.load is not None  # noqa: S101 - callers look
            try:
                self._codes[driver] = driver.load(self._resources)
            except Exception as error:  # noqa: BLE001 - the driver's own code
                self._codes[driver] = AgentError(in_words(error))
        code = self._codes[driver]
        if isinstance(code, AgentError):
            raise code
        return code

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._members if self._pool is None else self._pool,)


def _driver_or_pool(member: object) -> Driver | OpponentPool:
    if isinstance(member, Mapping):
        return OpponentPool(member)
    return member if isinstance(member, OpponentPool) else as_driver(member)


def name_of(driver: Driver) -> str:
    """Returns the name of a driver without loading it."""
    return driver.name or name_of_files(driver.source)
