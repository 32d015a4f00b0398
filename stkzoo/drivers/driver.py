"""Driver lookup by name: the game's AI, random actions, packages in ``stkzoo.agents``, files."""

from __future__ import annotations

import copy
import importlib
import os
import pickle
import pkgutil
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo._checks import shortened, unknown_name
from stkzoo.drivers.code import (
    Actor,
    ActorMaker,
    AgentCode,
    declared_view,
    load_agent,
    read_module,
)
from stkzoo.drivers.files import ACTOR_MODULE, AgentFiles, declared, find_files, is_zip
from stkzoo.drivers.inline import InlineAgent
from stkzoo.drivers.instances import DriverStart
from stkzoo.drivers.isolated import IsolatedAgent
from stkzoo.errors import ConfigError
from stkzoo.views import CAMERA_VIEWS, VIEWS, ViewFactory, extras_for, find_view

_AGENTS = "stkzoo.agents"
#: Packages in ``stkzoo.agents`` that are not drivers.
_NO_DRIVERS = {"pretrained", "planning", "training"}
#: Package of the learned drivers; each of its subpackages is a driver.
_PRETRAINED = "pretrained"
_NAME_MARK = "@:"
#: Names of the game's AI, and the difficulty that each name requires; ``None`` for any.
GAME_AI = {"ai": None, "ai:0": 0, "ai:1": 1, "ai:2": 2, "ai:3": 3}


#: Loads a driver's code. Closing the stack releases its resources.
CodeLoader = Callable[[ExitStack], AgentCode]


@dataclass(frozen=True, slots=True)
class Driver:
    """A driver. Each race starts its own instance of it.

    Attributes:
        name: display name; empty if the driver's code sets the name when it is loaded.
        start: starts an instance for one race; ``None`` for the game's AI.
        source: text from which the user selected the driver.
        difficulty: difficulty that the driver requires for the race; ``None`` for any. The game's
            AI has the same difficulty for all karts of a race.
        extras: observation entries that the driver needs beyond the ``full`` view
            (:data:`stkzoo.mdp.spaces.EXTRAS`).
        load: loads the driver's code into this process; ``None`` for the game's AI and for drivers
            that run in another process.
        is_from_files: whether the driver is loaded from the user's files, so an adapter applies.
    """

    name: str
    start: DriverStart | None
    source: str = ""
    difficulty: int | None = None
    extras: frozenset[str] = frozenset()
    load: CodeLoader | None = None
    is_from_files: bool = False

    @property
    def is_game_ai(self) -> bool:
        """Whether the driver is the game's AI."""
        return self.start is None

    @classmethod
    def of_actor(cls, name: str, make_actor: ActorMaker, view: object = "full") -> Driver:
        """Returns a driver that is a Python function.

        Args:
            name: display name.
            make_actor: creates the actor for one race from the observation space, the action space
                and a seed.
            view: view that defines the two spaces; see :func:`~stkzoo.views.find_view`.

        Raises:
            ConfigError: the view is unknown or contains images.
        """
        load = partial(_code_of_actor, make_actor, view)
        return cls._here(name, load, name, find_driver_view(view))

    @classmethod
    def of_policy(cls, policy: object, view: object = None, name: str = "") -> Driver:
        """Returns a driver that is a stateless policy.

        Args:
            policy: a function from an observation to an action, or an object with
                Stable-Baselines3's ``predict``. The latter is called once for all its karts, with
                ``deterministic=True``. The policy is not copied: if it learns, the driver changes.
            view: view of the policy; see :func:`~stkzoo.views.find_view`. ``None`` uses the view of
                the agents in the race (in :func:`~stkzoo.race.run_race`, ``full``).
            name: display name; by default, the name of the function or class.

        Raises:
            ConfigError: the policy is neither of these, or the view is unknown or contains images.
        """
        policy = plain_policy(policy)
        name = name or getattr(policy, "__name__", type(policy).__name__)
        load = partial(_code_of_policy, policy, view)
        return cls._here(
            name, load, name, VIEWS["full"] if view is None else find_driver_view(view)
        )

    @classmethod
    def _here(cls, name: str, load: CodeLoader, source: str, view: ViewFactory) -> Driver:
        """Returns a driver whose code runs in this process."""
        start = partial(InlineAgent, load=load)
        return cls(name, start, source, extras=extras_for(view), load=load)


def driver_names() -> list[str]:
    """Returns the names of the drivers that come with stkzoo."""
    learned = [f"{_PRETRAINED}:{name}" for name in _packages(f"{_AGENTS}.{_PRETRAINED}")]
    return ["ai", "random", *sorted({*_packages(_AGENTS)} - _NO_DRIVERS), *sorted(learned)]


def _packages(parent: str) -> list[str]:
    folder = importlib.import_module(parent).__path__
    return [module.name for module in pkgutil.iter_modules(folder) if module.ispkg]


def find_driver(
    text: str | os.PathLike[str], *, inline: bool = False, adapter: str | None = None
) -> Driver:
    """Returns the driver with a name.

    Args:
        text: ``"ai"`` for the game's AI; ``"ai:3"`` for the game's AI at difficulty 3, which then
            applies to the race; ``"random"`` for random actions; a package in ``stkzoo.agents``;
            ``"pretrained:NAME"`` for a learned driver; or an agent from files
            (``docs/reference/agents.md``): the path of a folder, zip or Python file, or the name of
            a module. A suffix ``@:Name`` sets the display name.
        inline: run agents from files in this process instead of one process per agent. This is
            faster.
        adapter: path of a Python file with ``create_actor(get_actor, module_dir,
            observation_space, action_space)`` for agents from files.

    Raises:
        ConfigError: no driver has this name, the files are not an agent, or the adapter does not
            exist.
    """
    if not isinstance(text, (str, os.PathLike)):
        raise ConfigError(f"a driver is {shortened(text)}, expected a name such as 'ai' or a path")
    text = os.fspath(text)
    source, mark, name = text.rpartition(_NAME_MARK) if _NAME_MARK in text else (text, "", "")
    if mark and not name:
        raise ConfigError(
            f"driver {text!r} has no name after {_NAME_MARK}; write one or leave it out"
        )
    if adapter is not None and not Path(adapter).is_file():
        raise ConfigError(f"there is no adapter {adapter!r}; expected the path of a Python file")
    driver = _find(source, inline, None if adapter is None else str(Path(adapter).resolve()))
    return replace(driver, source=source, name=name or driver.name)


def declared_name(source: str) -> str:
    """Returns the ``player_name`` of an agent from files without running it, or an empty string.

    Args:
        source: see ``text`` of :func:`find_driver`, without ``@:Name``.
    """
    files = None if source in (*GAME_AI, *driver_names()) else find_files(source)
    name = "" if files is None else declared(files, "player_name")
    return name if isinstance(name, str) else ""


def _find(source: str, inline: bool, adapter: str | None) -> Driver:
    if source in GAME_AI:
        return Driver(source, None, difficulty=GAME_AI[source])
    if source.startswith("ai:"):
        raise ConfigError(
            f"driver {source!r} is the game's AI at an unknown level; expected "
            f"{', '.join([*GAME_AI][1:])}, or ai for that of --difficulty"
        )
    if source == "random":
        return Driver.of_actor(source, _random_actor)
    if source in driver_names():
        module = f"{_AGENTS}.{source.replace(':', '.')}"
        module += f".{ACTOR_MODULE}" if source.startswith(_PRETRAINED) else ""
        load = partial(_load_shipped, module)
        return Driver._here(source, load, source, declared_view(AgentFiles(module, None)))
    if source.startswith(f"{_PRETRAINED}:"):
        raise unknown_name("driver", source, driver_names())
    files = find_files(source)
    if files is None:
        raise _unknown(source)
    driver = Driver._here("", partial(_load_files, files, adapter), source, declared_view(files))
    if not inline:
        start = partial(IsolatedAgent, files=files, adapter=adapter)
        driver = replace(driver, start=start, load=None)
    return replace(driver, is_from_files=True)


def _unknown(source: str) -> ConfigError:
    if "/" in source or is_zip(PurePath(source)) or source.endswith(".py"):
        return ConfigError(f"there is no agent {source!r}; expected a folder, a .zip or a .py file")
    error = unknown_name("driver", source, driver_names())
    return ConfigError(f"{error} Or give the path of a folder or zip, or a module's name.")


def _load_shipped(name: str, _: ExitStack) -> AgentCode:
    """Loads a shipped driver. Only these can define ``get_race_actor``, which sees the race."""
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(f"{name} cannot be loaded: {error}") from error
    return replace(read_module(module), make_race_actor=getattr(module, "get_race_actor", None))


def _load_files(files: AgentFiles, adapter: str | None, resources: ExitStack) -> AgentCode:
    return load_agent(files.place(resources), adapter)


def _code_of_actor(make_actor: ActorMaker, view: object, _: ExitStack) -> AgentCode:
    return AgentCode(find_driver_view(view), make_actor)


def _code_of_policy(policy: Any, view: object, _: ExitStack) -> AgentCode:
    together = act_together if hasattr(policy, "predict") else None
    wrap = None if view is None else find_driver_view(view)
    return AgentCode(wrap, partial(PolicyActor, policy), act_together=together)


def find_driver_view(choice: object) -> ViewFactory:
    """Returns a view for a driver.

    Args:
        choice: see :func:`~stkzoo.views.find_view`.

    Raises:
        ConfigError: the view is unknown or contains images.
    """
    if isinstance(choice, str) and choice in CAMERA_VIEWS:
        raise ConfigError(
            f"the view {choice!r} has pictures, which drivers do not get; use another"
        )
    return find_view(choice)


def _random_actor(_: spaces.Space[Any], action_space: spaces.Space[Any], seed: int) -> Actor:
    own_space = copy.deepcopy(action_space)
    own_space.seed(seed)
    return partial(_sample, own_space)


def _sample(action_space: spaces.Space[Any], _: Any) -> Any:
    return action_space.sample()


# ---------------------------------------------------------------------- policies


def plain_policy(policy: object) -> Any:
    """Returns the policy itself; for a Stable-Baselines3 algorithm, its ``policy``.

    Raises:
        ConfigError: the argument is not a policy.
    """
    if hasattr(policy, "predict") and not isinstance(policy, type):
        return getattr(policy, "policy", policy)
    if callable(policy) and not isinstance(policy, type):
        return policy
    raise ConfigError(
        f"a policy is {shortened(policy, 200)}, expected a function from an observation to an "
        "action, or an object with Stable-Baselines3's predict"
    )


def frozen_policy(policy: object) -> Any:
    """Returns a copy of a policy, which later learning does not change.

    Raises:
        ConfigError: the argument is not a policy, or cannot be copied.
    """
    policy = plain_policy(policy)
    with suppress(Exception):  # a PPO policy that has learned contains an autograd graph
        return copy.deepcopy(policy)
    try:
        return pickle.loads(pickle.dumps(policy))  # noqa: S301 - pickled here
    except Exception as error:
        raise ConfigError(
            f"the policy {shortened(policy, 200)} cannot be copied ({error}); give a function "
            "from an observation to an action that needs nothing that still learns"
        ) from error


class PolicyActor:
    """An actor that applies a stateless policy to one kart.

    Args:
        policy: policy from :func:`plain_policy`.
        observation_space: space of the kart's observations.
    """

    def __init__(self, policy: Any, observation_space: spaces.Space[Any], *_: object) -> None:
        self.policy, self.observation_space = policy, observation_space

    def __call__(self, observation: Any) -> Any:
        """Returns the action for an observation."""
        if hasattr(self.policy, "predict"):
            return act_together([self], [observation])[0]
        return self.policy(observation)

    def __deepcopy__(self, _: dict[int, Any]) -> PolicyActor:
        return self


def act_together(actors: Sequence[Actor], observations: Sequence[Any]) -> Sequence[Any]:
    """Returns the deterministic actions of several karts with one call of ``predict``.

    Args:
        actors: :class:`PolicyActor` objects with the same policy and view.
        observations: one observation per actor.
    """
    actor: Any = actors[0]
    seen = actor.observation_space
    if isinstance(seen, spaces.Dict):
        batch: Any = {key: np.stack([entry[key] for entry in observations]) for key in seen.spaces}
    else:
        batch = np.stack(observations)
    actions, _ = actor.policy.predict(batch, deterministic=True)
    return list(actions)
