"""Loads an agent's module and reads its view, actor and name."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator

from stkzoo._checks import shortened, unknown_name
from stkzoo.drivers.files import INSTALLED, AgentFiles, AgentPlace, declared
from stkzoo.errors import ConfigError
from stkzoo.views import VIEWS, View, ViewFactory, find_view

#: Returns an action for an observation.
Actor = Callable[[Any], Any]

#: Creates the actor for one race from an observation space, an action space and a seed.
ActorMaker = Callable[[spaces.Space[Any], spaces.Space[Any], int], Actor]

#: Creates the actor for one race from the environment of the race and a seed.
RaceActorMaker = Callable[[object, int], AbstractContextManager[Actor]]

#: Returns the actions of several karts for their actors and observations.
BatchActor = Callable[[Sequence[Actor], Sequence[Any]], Sequence[Any]]

#: Package with the names of ``pystk2_gymnasium``. It is a layer above this one, so it is imported
#: only when an agent is loaded.
_REFERENCE = "stkzoo._pystk2_gymnasium"
_DEFAULT_ENV = "supertuxkart/full-v0"
#: Package with the tasks of the suite, another layer above, and the beginning of their ids.
_SUITE, _TASK_IDS = "stkzoo.suite", "stkzoo-suite/"


@dataclass(frozen=True, slots=True)
class AgentCode:
    """The loaded code of an agent.

    Attributes:
        wrap: wraps the kart's environment (the ``full`` view) into the agent's view; ``None`` for
            the view of the other agents in the race.
        make_actor: creates the actor for one race.
        name: name that the agent declares; may be empty.
        scope: context in which the agent's code must run.
        act_together: returns the actions of several of the agent's karts; ``None`` if the agent
            does not support this.
        make_race_actor: creates the actor of a driver that plans with copies of the race, for the
            duration of a context and instead of ``make_actor``; ``None`` for drivers that decide
            from observations alone.
    """

    wrap: ViewFactory | None
    make_actor: ActorMaker
    name: str = ""
    scope: AbstractContextManager[Any] = field(default_factory=nullcontext)
    act_together: BatchActor | None = None
    make_race_actor: RaceActorMaker | None = None


def load_agent(place: AgentPlace, adapter: str | None = None) -> AgentCode:
    """Loads an agent from its files.

    Args:
        place: how to import the agent.
        adapter: path of a Python file. Its ``create_actor(get_actor, module_dir,
            observation_space, action_space)`` creates the actor instead of the agent's
            ``get_actor``. Its optional ``prepare_module_dir(folder)`` is called before the agent is
            imported.

    Raises:
        ConfigError: the module is not an agent, or the adapter is invalid.
        Exception: any exception that the module raises.
    """
    create_actor = None
    if adapter is not None:
        helper = _run_file("stkzoo_race_adapter", Path(adapter))
        arguments = ("get_actor", "module_dir", "observation_space", "action_space")
        create_actor = _required(helper, "create_actor", *arguments)
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
    """Reads the agent's code from its module.

    Args:
        module: a module with ``get_actor(module_dir, observation_space, action_space)`` and
            optionally ``create_state()``, ``get_wrappers()``, ``env_name``, ``player_name`` and
            ``get_batch_actor(module_dir)``. The latter returns a function from the states and
            observations of several karts to their actions.
        scope: context in which the agent's code must run.
        create_actor: the adapter's function; ``None`` without an adapter.

    Raises:
        ConfigError: the module is not an agent.
    """
    folder = Path(str(module.__file__)).parent
    arguments = ("module_dir", "observation_space", "action_space")
    get_actor = _required(module, "get_actor", *arguments)
    if create_actor is None:
        _check_call(get_actor, "get_actor", *arguments)
    else:
        get_actor = partial(create_actor, get_actor)
    create_state = _function_of(module, "create_state", lambda: None)

    def make_actor(
        observation_space: spaces.Space[Any], action_space: spaces.Space[Any], _: int
    ) -> Actor:
        actor = get_actor(folder, observation_space, action_space)
        if not callable(actor):
            raise ConfigError(
                f"get_actor returned {shortened(actor, 200)}; expected a function "
                "(state, observation)"
            )
        _check_call(actor, "the actor", "state", "observation")
        return partial(actor, create_state())

    view = _view_of(getattr(module, "env_name", _DEFAULT_ENV))
    wrappers = map(find_view, _function_of(module, "get_wrappers", list)() or [])
    name = str(getattr(module, "player_name", ""))
    wrap = View("own", "An agent's own.", (view, *wrappers))
    together = None
    if create_actor is None and hasattr(module, "get_batch_actor"):
        get_batch_actor = _function_of(module, "get_batch_actor")
        together = partial(_act_together, functools.cache(partial(get_batch_actor, folder)))
    return AgentCode(wrap, make_actor, name, scope or nullcontext(), together)


def _required(module: ModuleType, name: str, *arguments: str) -> Callable[..., Any]:
    """Returns a function that a module must have.

    Raises:
        ConfigError: the module has no such function.
    """
    function: object = getattr(module, name, None)
    if not callable(function):
        raise ConfigError(
            f"{module.__file__} has no function {name}; expected {name}({', '.join(arguments)})"
        )
    return function


def _function_of(module: ModuleType, name: str, default: object = None) -> Callable[..., Any]:
    """Returns a function of an agent's module.

    Raises:
        ConfigError: it is not a function.
    """
    function = getattr(module, name, default)
    if not callable(function):
        raise ConfigError(f"{name} is {shortened(function)}; expected a function")
    return function


def _check_call(function: Callable[..., Any], name: str, *arguments: str) -> None:
    """Checks that a function accepts these positional arguments.

    Raises:
        ConfigError: the function does not accept them.
    """
    try:
        signature = inspect.signature(function, follow_wrapped=False)
    except (TypeError, ValueError):
        return  # functions in C may have no signature
    try:
        signature.bind(*arguments)
    except TypeError:
        expected = ", ".join(arguments)
        raise ConfigError(f"{name} takes {signature}; expected ({expected})") from None


def _act_together(
    batch_actor: Callable[[], Callable[[list[Any], Sequence[Any]], Sequence[Any]]],
    actors: Sequence[Actor],
    observations: Sequence[Any],
) -> Sequence[Any]:
    """Returns the actions of several actors of :func:`read_module`."""
    states = [actor.args[0] for actor in actors]  # type: ignore[attr-defined] # partials of states
    return batch_actor()(states, observations)


def _view_of(env_name: object) -> ViewFactory:
    """Returns the view for an environment id, or for a pair of an id and options of the view.

    Raises:
        ConfigError: the id or its version is unknown.
    """
    if isinstance(env_name, (tuple, list)) and len(env_name) == 2:
        return find_view((_view_of(env_name[0]), env_name[1]))
    if not isinstance(env_name, str):
        raise ConfigError(
            f"env_name is {env_name!r}, expected text such as {_DEFAULT_ENV!r}, or that and "
            "options of the view, such as ('supertuxkart/simple-v0', {'state_items': 3})"
        )
    if env_name.startswith(_TASK_IDS):
        view: ViewFactory = importlib.import_module(_SUITE).view_of(env_name)
        return view
    name = env_name.removeprefix("supertuxkart/").removesuffix("-v0")
    if name in VIEWS:
        return VIEWS[name]
    spec = gym.registry.get(env_name)
    if spec is None or not spec.additional_wrappers:
        name = name.partition("-v")[0]  # a view exists in one version
        known = [f"supertuxkart/{view}-v0" for view in ([name] if name in VIEWS else VIEWS)]
        raise unknown_name("env_name", env_name, known)
    wrappers: list[Any] = [
        partial(load_env_creator(wrapper.entry_point), **(wrapper.kwargs or {}))
        for wrapper in spec.additional_wrappers
    ]
    return View(name, f"The wrappers of {env_name}.", tuple(wrappers))


def declared_view(files: AgentFiles) -> ViewFactory:
    """Returns the view that an agent's module names; ``full`` if it names none that exists.

    The agent's module does not run.
    """
    try:
        return _view_of(declared(files, "env_name"))
    except (ConfigError, RecursionError):
        return VIEWS["full"]  # reported when the agent is loaded


def _run_file(name: str, file: Path) -> ModuleType:
    """Imports a file under a name; an ``__init__.py`` as the package in its folder.

    The name of such a folder may not be a valid identifier.
    """
    folders = [str(file.parent)] if file.name == "__init__.py" else None
    spec = importlib.util.spec_from_file_location(name, file, submodule_search_locations=folders)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{str(file)!r} is not a Python file")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        sys.modules.pop(name, None)
        raise
    return module


class ModuleScope:
    """A context in which ``import`` finds an agent's modules.

    It separates agents whose files have the same names. On entry, it adds the agent's modules and
    folders to ``sys.modules`` and ``sys.path``. On exit, it removes them and restores other modules
    with the same names. It is reentrant. Inside the context, ``pystk2_gymnasium`` is stkzoo's
    replacement, even if the original package is installed.

    Args:
        place: how the agent's module is imported.
    """

    def __init__(self, place: AgentPlace) -> None:
        self._place = place
        self._roots = [Path(root) for root in (place.first, place.last) if root]
        self._names = frozenset(_top(name) for name in place.modules) | _siblings(place)
        self._own: dict[str, ModuleType] = importlib.import_module(_REFERENCE).modules()
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
        if len(sys.modules) > self._count:
            self._own.update(self._new_modules())
        for name in self._own:
            sys.modules.pop(name, None)
        sys.modules.update(self._hidden)
        for root in (self._place.first, self._place.last):
            if root in sys.path:
                sys.path.remove(root)

    def load(self) -> ModuleType:
        """Imports the agent's module. Call it inside the context.

        Raises:
            ModuleNotFoundError: the module, or a module that it imports, does not exist.
        """
        importlib.invalidate_caches()
        if self._place.package and _top(self._place.modules[0]) not in sys.modules:
            _run_file(_top(self._place.modules[0]), Path(self._place.package, "__init__.py"))
        *others, last = self._place.modules
        for name in others:
            try:
                return importlib.import_module(name)
            except ModuleNotFoundError as error:  # noqa: PERF203 - two at most
                if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                    raise  # an import inside the agent failed
        return importlib.import_module(last)

    def _others(self) -> dict[str, ModuleType]:
        """Returns the loaded modules whose names the agent's modules use too."""
        foreign = {name for name in self._names if self._owns(sys.modules.get(name)) is False}
        loaded = list(sys.modules.items()) if foreign else []
        others = {name: module for name, module in loaded if _top(name) in foreign}
        return others | {name: sys.modules[name] for name in self._own if name in sys.modules}

    def _new_modules(self) -> dict[str, ModuleType]:
        # Those that were imported in the context are the last ones. Others in the agent's folders
        # are the program's.
        latest = list(islice(reversed(sys.modules.items()), len(sys.modules) - self._count))
        return {
            name: module
            for name, module in reversed(latest)
            if name not in self._own and _top(name) != "stkzoo" and self._owns(module)
        }

    def _owns(self, module: ModuleType | None) -> bool | None:
        """Returns whether a module is the agent's; ``None`` if it is built in or installed."""
        path = _path_of(module)
        if path is None:
            return None
        root = next((root for root in self._roots if path.is_relative_to(root)), None)
        parts = path.parts if root is None else path.relative_to(root).parts
        return None if INSTALLED & set(parts) else root is not None


def _path_of(module: ModuleType | None) -> Path | None:
    """Returns the path of a module's code; ``None`` for built-in modules."""
    file = getattr(module, "__file__", None)
    if not isinstance(file, str):
        folders = list(getattr(module, "__path__", None) or ())
        file = folders[0] if folders else None
    return Path(file) if isinstance(file, str) else None


def _top(name: str) -> str:
    return name.partition(".")[0]


def _siblings(place: AgentPlace) -> frozenset[str]:
    """Returns the modules in the agent's folder, which it can import by their plain names."""
    if not place.first or place.package:
        return frozenset()
    names = {entry.stem for entry in Path(place.first).glob("*.py")}
    names |= {entry.parent.name for entry in Path(place.first).glob("*/__init__.py")}
    return frozenset(names - set(sys.stdlib_module_names))
