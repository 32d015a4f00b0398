"""An agent's code: loads its module and reads how it observes, acts and what it is called."""

from __future__ import annotations

import importlib
import importlib.util
import sys
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
from stkzoo.race.agents.files import AgentPlace
from stkzoo.views import VIEWS, View, sees_ground

__all__ = [
    "Actor",
    "ActorMaker",
    "AgentCode",
    "ModuleScope",
    "env_sees_ground",
    "load_agent",
    "read_module",
]

#: Picks an action for an observation.
Actor = Callable[[Any], Any]

#: Makes the actor of one race from its observation space, action space and a seed.
ActorMaker = Callable[[spaces.Space[Any], spaces.Space[Any], int], Actor]

_DEFAULT_ENV = "supertuxkart/full-v0"
_INSTALLED = {"site-packages", "dist-packages"}


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


class ModuleScope:
    """A context in which an agent's modules are the ones that ``import`` finds.

    On entry the agent's own modules and folders take their places in ``sys.modules`` and
    ``sys.path``; on exit they leave them again, and whoever else bears the same names is
    back. May be entered within itself. ``pystk2_gymnasium`` is stkzoo's own in it
    (:mod:`stkzoo.compat`).
    """

    def __init__(self, place: AgentPlace) -> None:
        self._place = place
        self._roots = [Path(root) for root in (place.first, place.last) if root]
        self._names = frozenset(_top(name) for name in place.modules) | _siblings(place)
        self._own = _compat_modules()
        self._hidden: dict[str, ModuleType] = {}
        self._depth = self._count = 0

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth > 1:
            return
        self._hidden = self._others()
        for name in self._hidden:
            del sys.modules[name]
        sys.modules.update(self._own)
        if self._place.first:
            sys.path.insert(0, self._place.first)
        if self._place.last:
            sys.path.append(self._place.last)
        self._count = len(sys.modules)

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth:
            return
        if len(sys.modules) != self._count:
            self._own.update(self._new_modules())
        for name in self._own:
            sys.modules.pop(name, None)
        sys.modules.update(self._hidden)
        for root in (self._place.first, self._place.last):
            if root in sys.path:
                sys.path.remove(root)

    def load(self) -> ModuleType:
        """Imports the agent's module; call it inside the context.

        Raises:
            ModuleNotFoundError: there is no such module.
        """
        importlib.invalidate_caches()
        if self._place.package:
            _import_package(Path(self._place.package), self._place.modules[0].partition(".")[0])
        *others, last = self._place.modules
        for name in others:
            try:
                return importlib.import_module(name)
            except ModuleNotFoundError as error:  # noqa: PERF203 - two at most
                if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                    raise  # the agent's own imports fail
        return importlib.import_module(last)

    def _others(self) -> dict[str, ModuleType]:
        """Modules that bear the agent's names at the moment."""
        strange = {name for name in self._names if name in sys.modules and self._is_strange(name)}
        named = {name: sys.modules[name] for name in self._own if name in sys.modules}
        if not strange:
            return named
        loaded = list(sys.modules.items())
        return named | {name: module for name, module in loaded if _top(name) in strange}

    def _new_modules(self) -> dict[str, ModuleType]:
        return {
            name: module
            for name, module in list(sys.modules.items())
            if name not in self._own and _top(name) != "stkzoo" and self._is_own(module)
        }

    def _is_own(self, module: ModuleType) -> bool:
        path = _path_of(module)
        return path is not None and any(
            path.is_relative_to(root) and not _INSTALLED & set(path.relative_to(root).parts)
            for root in self._roots
        )

    def _is_strange(self, name: str) -> bool:
        """Whether a module is another one than the agent means by its name."""
        path = _path_of(sys.modules.get(_top(name)))
        if path is None or _INSTALLED & set(path.parts):
            return False
        return not any(path.is_relative_to(root) for root in self._roots)


def _compat_modules() -> dict[str, ModuleType]:
    """What agents find as ``pystk2_gymnasium``, whether the real one is installed or not."""
    home, name = "stkzoo.compat.", "pystk2_gymnasium"
    importlib.import_module(home + name)
    return {
        full.removeprefix(home): module
        for full, module in list(sys.modules.items())
        if full.startswith(home + name)
    }


def _path_of(module: ModuleType | None) -> Path | None:
    """Where a module's code lies; ``None`` for those that are built in."""
    file = getattr(module, "__file__", None)
    if not isinstance(file, str):
        folders = list(getattr(module, "__path__", None) or ())
        file = folders[0] if folders else None
    return Path(file) if isinstance(file, str) else None


def _top(name: str) -> str:
    return name.partition(".")[0]


def _siblings(place: AgentPlace) -> frozenset[str]:
    """Modules beside the agent's, which it may import by their bare names."""
    if not place.first or place.package:
        return frozenset()
    names = {entry.stem for entry in Path(place.first).glob("*.py")}
    names |= {entry.parent.name for entry in Path(place.first).glob("*/__init__.py")}
    return frozenset(names - set(sys.stdlib_module_names))


def _import_package(folder: Path, name: str) -> None:
    """Imports a package by its folder, which need not have a name that can be imported."""
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"no package in {folder}", name=name)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        sys.modules.pop(name, None)
        raise
