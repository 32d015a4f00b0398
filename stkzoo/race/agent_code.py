"""What an agent's module says: how it sees, how it decides, what it is called."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator

from stkzoo.errors import ConfigError, unknown_name
from stkzoo.race.files import AgentPlace
from stkzoo.race.modules import ModuleScope
from stkzoo.views import VIEWS, View, sees_ground

__all__ = ["Actor", "ActorMaker", "AgentCode", "env_sees_ground", "load_agent", "read_module"]

#: Picks an action for an observation.
Actor = Callable[[Any], Any]

#: Makes the actor of one race from its observation space, action space and a seed.
ActorMaker = Callable[[spaces.Space[Any], spaces.Space[Any], int], Actor]

_DEFAULT_ENV = "supertuxkart/full-v0"


@dataclass(frozen=True, slots=True)
class AgentCode:
    """An agent's code, loaded.

    Attributes:
        wrap: wraps the environment of its kart (the ``full`` view) into its own view.
        make_actor: makes its actor for one race.
        name: what it calls itself; empty if it does not say.
        scope: context in which its code runs.
    """

    wrap: View
    make_actor: ActorMaker
    name: str = ""
    scope: AbstractContextManager[Any] = field(default_factory=nullcontext)


def load_agent(place: AgentPlace, adapter: str | None = None) -> AgentCode:
    """Loads an agent from its files.

    Args:
        place: where they are.
        adapter: path of a Python file whose ``create_actor(get_actor, module_dir,
            observation_space, action_space)`` makes the actor in place of the agent's own
            ``get_actor``, and whose ``prepare_module_dir(folder)``, if there is one, is
            called before the agent is imported.

    Raises:
        ConfigError: the module is not made like an agent.
        Exception: whatever the module itself raises.
    """
    create_actor = None
    if adapter is not None:
        helper = _load_adapter(Path(adapter))
        create_actor = helper.create_actor
        if hasattr(helper, "prepare_module_dir"):
            helper.prepare_module_dir(Path(place.package or place.first or place.last))
    scope = ModuleScope(place)
    with scope:
        return read_module(scope.load(), scope, create_actor)


def read_module(
    module: ModuleType,
    scope: AbstractContextManager[Any] | None = None,
    create_actor: Callable[..., Actor] | None = None,
) -> AgentCode:
    """The code in a module that is made like an agent.

    Args:
        module: has ``get_actor(module_dir, observation_space, action_space)`` and may have
            ``create_state()``, ``get_wrappers()``, ``env_name`` and ``player_name``.
        scope: context in which its code runs.
        create_actor: an adapter's function.

    Raises:
        ConfigError: it is not made like an agent.
    """
    folder = Path(str(module.__file__)).parent
    get_actor = getattr(module, "get_actor", None)
    if not callable(get_actor):
        raise ConfigError(
            f"{module.__file__} has no function get_actor; expected "
            "get_actor(module_dir, observation_space, action_space)"
        )
    if create_actor is not None:
        get_actor = partial(create_actor, get_actor)
    create_state = getattr(module, "create_state", _no_state)

    def make_actor(
        observation_space: spaces.Space[Any], action_space: spaces.Space[Any], _: int
    ) -> Actor:
        actor = get_actor(folder, observation_space, action_space)
        if not callable(actor):
            raise ConfigError(f"get_actor returned {actor!r}; expected a function (state, obs)")
        return partial(actor, create_state())

    view = _view_of(getattr(module, "env_name", _DEFAULT_ENV))
    wrappers = list(getattr(module, "get_wrappers", list)() or [])
    name = str(getattr(module, "player_name", ""))
    return AgentCode(partial(_wrap, view, wrappers), make_actor, name, scope or nullcontext())


def _no_state() -> None:
    return None


def _wrap(view: View, wrappers: list[View], env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    env = view(env)
    for wrapper in wrappers:
        env = wrapper(env)
    return env


def _view_of(env_name: object) -> View:
    """The view of an environment's id: one of ours, or the wrappers of a registered one."""
    if not isinstance(env_name, str):
        raise ConfigError(f"env_name is {env_name!r}, expected a text such as {_DEFAULT_ENV!r}")
    name = _view_name(env_name)
    if name in VIEWS:
        return VIEWS[name]
    spec = gym.registry.get(env_name)
    if spec is None or not spec.additional_wrappers:
        known = [f"supertuxkart/{view}-v0" for view in VIEWS]
        raise unknown_name("env_name", env_name, known)
    wrappers: list[Any] = [
        partial(load_env_creator(wrapper.entry_point), **(wrapper.kwargs or {}))
        for wrapper in spec.additional_wrappers
    ]
    return partial(_wrap, VIEWS["full"], wrappers)


def env_sees_ground(env_name: str) -> bool:
    """Whether an environment's id is of a view with the ground beside the road."""
    view = VIEWS.get(_view_name(env_name))
    return view is not None and sees_ground(view)


def _view_name(env_name: str) -> str:
    return env_name.removeprefix("supertuxkart/").rsplit("-v", 1)[0]


def _load_adapter(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("stkzoo_race_adapter", path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ConfigError(f"the adapter {str(path)!r} is no Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not callable(getattr(module, "create_actor", None)):
        raise ConfigError(
            f"the adapter {str(path)!r} has no function create_actor; expected "
            "create_actor(get_actor, module_dir, observation_space, action_space)"
        )
    return module
