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
from stkzoo.race.agents.code import Actor, ActorMaker, AgentCode, env_sees_ground, read_module
from stkzoo.race.agents.files import AgentFiles, declared_env, find_files
from stkzoo.race.agents.inline import ActorOpener, InlineFilesOpener, InlineInstance
from stkzoo.race.agents.isolated import IsolatedOpener
from stkzoo.race.instances import DriverInstance, DriverRequest, DriverStart

__all__ = ["Actor", "ActorMaker", "Driver", "driver_names", "find_driver"]

_AGENTS = "stkzoo.agents"
#: What is there beside drivers that can be raced by name.
_NO_DRIVERS = {"planner", "pretrained", "planning", "training"}
#: Learned drivers, each a package of this one.
_PRETRAINED = "pretrained"
_NAME_MARK = "@:"
#: Levels of the game's AI.
_LEVELS = ("0", "1", "2", "3")


@dataclass(frozen=True, slots=True)
class Driver:
    """Somebody who can drive a kart.

    Attributes:
        name: what it is called; empty if it says so itself when it is loaded.
        start: opens its seat in one race; ``None`` for the game's AI.
        source: where it comes from, as the user wrote it.
        difficulty: that of the race, if it says so: the game's AI of one race has one level.
        sees_ground: whether its observations tell of the ground beside the road.
    """

    name: str
    start: DriverStart | None
    source: str = ""
    difficulty: int | None = None
    sees_ground: bool = False

    @property
    def is_game_ai(self) -> bool:
        """Whether the game drives the kart itself."""
        return self.start is None

    @classmethod
    def of_actor(cls, name: str, make_actor: ActorMaker, view: str = "full") -> Driver:
        """A driver that is a Python function.

        Args:
            name: what it is called.
            make_actor: makes its actor for one race from its observation space, its
                action space and a seed.
            view: name of the view in which it sees and acts.
        """
        return cls(name, ActorOpener(make_actor, view), name, sees_ground=env_sees_ground(view))


def driver_names() -> list[str]:
    """The names of the drivers that come with stkzoo."""
    learned = [f"{_PRETRAINED}:{name}" for name in _packages(f"{_AGENTS}.{_PRETRAINED}")]
    return ["ai", "random", *sorted({*_packages(_AGENTS)} - _NO_DRIVERS), *sorted(learned)]


def _packages(parent: str) -> list[str]:
    folder = importlib.import_module(parent).__path__
    return [module.name for module in pkgutil.iter_modules(folder) if module.ispkg]


def find_driver(text: str, *, inline: bool = False, adapter: str | None = None) -> Driver:
    """The driver that a text names.

    Args:
        text: ``"ai"`` for the game's AI, ``"ai:3"`` for that at difficulty 3, which is then
            the race's, ``"random"`` for random actions, a package under
            ``stkzoo.agents``, ``"pretrained:NAME"`` for a learned one there, or an agent of
            files (``docs/agents.md``): the path of a folder, zip or Python file, or the name
            of a module. ``@:Name`` behind it says what to call the driver.
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
    if source.startswith("ai:"):
        return Driver(source, None, difficulty=_level(source))
    if source == "random":
        return Driver.of_actor(source, _random_actor)
    if source in driver_names():
        module = f"{_AGENTS}.{source.replace(':', '.')}"
        env_name = declared_env(AgentFiles(module, None))
        return Driver(source, _ShippedOpener(module), sees_ground=env_sees_ground(env_name))
    if source.startswith(f"{_PRETRAINED}:"):
        raise unknown_name("driver", source, driver_names())
    if adapter is not None and not Path(adapter).is_file():
        raise ConfigError(f"there is no adapter {adapter!r}; expected the path of a Python file")
    files = find_files(source)
    if files is None:
        raise _nobody(source)
    opener = InlineFilesOpener(files, adapter) if inline else IsolatedOpener(files, adapter)
    return Driver("", opener, sees_ground=env_sees_ground(declared_env(files)))


def _level(source: str) -> int:
    """The difficulty in ``"ai:3"``."""
    level = source.removeprefix("ai:")
    if level not in _LEVELS:
        raise ConfigError(
            f"driver {source!r} is the game's AI at a level that it does not have; expected "
            f"{', '.join(f'ai:{known}' for known in _LEVELS)}, or ai for that of --difficulty"
        )
    return int(level)


def _nobody(source: str) -> ConfigError:
    if "/" in source or source.endswith((".zip", ".py")):
        return ConfigError(f"there is no agent {source!r}; expected a folder, a .zip or a .py file")
    error = unknown_name("driver", source, driver_names())
    return ConfigError(f"{error} Or give the path of a folder or zip, or a module's name.")


@dataclass(frozen=True, slots=True)
class _ShippedOpener:
    """Opens seats of a package under ``stkzoo.agents``."""

    module: str

    def __call__(self, request: DriverRequest) -> DriverInstance:
        return InlineInstance(request, lambda _: self._code(request.agent))

    def _code(self, agent: str) -> AgentCode:
        try:
            return read_module(importlib.import_module(self.module))
        except ImportError as error:
            raise AgentError(f"{self.module} cannot be loaded: {error}", agent) from error


def _random_actor(_: spaces.Space[Any], action_space: spaces.Space[Any], seed: int) -> Actor:
    own_space = copy.deepcopy(action_space)
    own_space.seed(seed)
    return lambda _: own_space.sample()
