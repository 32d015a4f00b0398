"""Drivers by name: the game's AI, chance, and every package under ``stkzoo.agents``."""

from __future__ import annotations

import copy
import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from gymnasium import spaces

from stkzoo.errors import AgentError, unknown_name

__all__ = ["Actor", "ActorMaker", "Driver", "driver_names", "find_driver"]

#: Picks an action for an observation.
Actor = Callable[[Any], Any]

#: Makes the actor of one race from its observation space, action space and a seed.
ActorMaker = Callable[[spaces.Space[Any], spaces.Space[Any], int], Actor]

_AGENTS = "stkzoo.agents"


@dataclass(frozen=True, slots=True)
class Driver:
    """Somebody who can drive a kart.

    Attributes:
        name: what it is called.
        make_actor: makes its actor for one race; ``None`` for the game's AI.
        view: the view in which it sees and acts.
    """

    name: str
    make_actor: ActorMaker | None
    view: str = "full"

    @property
    def is_game_ai(self) -> bool:
        """Whether the game drives the kart itself."""
        return self.make_actor is None


def driver_names() -> list[str]:
    """All names that :func:`find_driver` knows."""
    folder = importlib.import_module(_AGENTS).__path__
    return ["ai", "random", *sorted(module.name for module in pkgutil.iter_modules(folder))]


def find_driver(name: str) -> Driver:
    """The driver of a name.

    Args:
        name: ``"ai"`` for the game's AI, ``"random"`` for random actions, else the name
            of a package under ``stkzoo.agents``, whose form is described there.

    Raises:
        ConfigError: nobody has this name.
        AgentError: the package cannot be used.
    """
    if name == "ai":
        return Driver(name, None)
    if name == "random":
        return Driver(name, _random_actor)
    if name not in driver_names():
        raise unknown_name("driver", name, driver_names())
    try:
        module = importlib.import_module(f"{_AGENTS}.{name}")
        return _driver_of(name, module)
    except (ImportError, AttributeError) as error:
        raise AgentError(f"driver {name!r} cannot be loaded: {error}", name) from error


def _random_actor(_: spaces.Space[Any], action_space: spaces.Space[Any], seed: int) -> Actor:
    own_space = copy.deepcopy(action_space)
    own_space.seed(seed)
    return lambda _: own_space.sample()


def _driver_of(name: str, module: ModuleType) -> Driver:
    folder = Path(str(module.__file__)).parent
    get_actor, create_state = module.get_actor, getattr(module, "create_state", dict)

    def make_actor(
        observation_space: spaces.Space[Any], action_space: spaces.Space[Any], _: int
    ) -> Actor:
        actor = get_actor(folder, observation_space, action_space)
        state: Any = create_state()
        return lambda observation: actor(state, observation)

    return Driver(name, make_actor, _view_of(module.env_name))


def _view_of(env_name: str) -> str:
    return env_name.removeprefix("supertuxkart/").rsplit("-v", 1)[0]
