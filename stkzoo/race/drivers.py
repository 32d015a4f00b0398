"""Drivers by name: the game's AI, chance, packages under ``stkzoo.agents``, and files."""

from __future__ import annotations

import copy
import importlib
import pkgutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gymnasium import spaces

from stkzoo.errors import AgentError, ConfigError, unknown_name
from stkzoo.race.agent_code import Actor, ActorMaker, AgentCode, read_module
from stkzoo.race.files import find_files
from stkzoo.race.inline import ActorOpener, InlineFilesOpener, InlineSeat
from stkzoo.race.isolation import IsolatedOpener
from stkzoo.race.seats import Seat, SeatOpener, SeatRequest

__all__ = ["Actor", "ActorMaker", "Driver", "driver_names", "find_driver"]

_AGENTS = "stkzoo.agents"
#: What is there beside drivers that can be raced by name.
_NO_DRIVERS = {"planner", "training"}
_NAME_MARK = "@:"


@dataclass(frozen=True, slots=True)
class Driver:
    """Somebody who can drive a kart.

    Attributes:
        name: what it is called; empty if it says so itself when it is loaded.
        open_seat: opens its seat in one race; ``None`` for the game's AI.
        source: where it comes from, as the user wrote it.
    """

    name: str
    open_seat: SeatOpener | None
    source: str = ""

    @property
    def is_game_ai(self) -> bool:
        """Whether the game drives the kart itself."""
        return self.open_seat is None

    @classmethod
    def of_actor(cls, name: str, make_actor: ActorMaker, view: str = "full") -> Driver:
        """A driver that is a Python function.

        Args:
            name: what it is called.
            make_actor: makes its actor for one race from its observation space, its
                action space and a seed.
            view: name of the view in which it sees and acts.
        """
        return cls(name, ActorOpener(make_actor, view), name)


def driver_names() -> list[str]:
    """The names of the drivers that come with stkzoo."""
    folder = importlib.import_module(_AGENTS).__path__
    found = {module.name for module in pkgutil.iter_modules(folder)}
    return ["ai", "random", *sorted(found - _NO_DRIVERS)]


def find_driver(text: str, *, inline: bool = False, adapter: str | None = None) -> Driver:
    """The driver that a text names.

    Args:
        text: ``"ai"`` for the game's AI, ``"random"`` for random actions, a package under
            ``stkzoo.agents``, or an agent of files (``docs/agents.md``): the path of a
            folder, zip or Python file, or the name of a module. ``@:Name`` behind it
            says what to call the driver.
        inline: run agents from files in this process, which is quicker, instead of one
            each in a process of its own.
        adapter: path of a Python file with ``create_actor(get_actor, module_dir,
            observation_space, action_space)`` for agents from files.

    Raises:
        ConfigError: nobody is called this, or the files are no agent.
    """
    source, mark, name = text.rpartition(_NAME_MARK) if _NAME_MARK in text else (text, "", "")
    if mark and not name:
        raise ConfigError(
            f"driver {text!r} has no name after {_NAME_MARK}; write one or leave it out"
        )
    driver = _find(source, inline, None if adapter is None else str(Path(adapter).resolve()))
    return replace(driver, source=source, name=name or driver.name)


def _find(source: str, inline: bool, adapter: str | None) -> Driver:
    if source == "ai":
        return Driver(source, None)
    if source == "random":
        return Driver.of_actor(source, _random_actor)
    if source in driver_names():
        return Driver(source, _ShippedOpener(f"{_AGENTS}.{source}"))
    if adapter is not None and not Path(adapter).is_file():
        raise ConfigError(f"there is no adapter {adapter!r}; expected the path of a Python file")
    files = find_files(source)
    if files is None:
        raise _nobody(source)
    opener = InlineFilesOpener(files, adapter) if inline else IsolatedOpener(files, adapter)
    return Driver("", opener)


def _nobody(source: str) -> ConfigError:
    if "/" in source or source.endswith((".zip", ".py")):
        return ConfigError(f"there is no agent {source!r}; expected a folder, a .zip or a .py file")
    error = unknown_name("driver", source, driver_names())
    return ConfigError(f"{error} Or give the path of a folder or zip, or a module's name.")


@dataclass(frozen=True, slots=True)
class _ShippedOpener:
    """Opens seats of a package under ``stkzoo.agents``."""

    module: str

    def __call__(self, request: SeatRequest) -> Seat:
        return InlineSeat(request, lambda _: self._code(request.agent))

    def _code(self, agent: str) -> AgentCode:
        try:
            return read_module(importlib.import_module(self.module))
        except ImportError as error:
            raise AgentError(f"{self.module} cannot be loaded: {error}", agent) from error


def _random_actor(_: spaces.Space[Any], action_space: spaces.Space[Any], seed: int) -> Actor:
    own_space = copy.deepcopy(action_space)
    own_space.seed(seed)
    return lambda _: own_space.sample()
