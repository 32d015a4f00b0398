"""The registry of views, and the choice of views by name."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

import gymnasium as gym
from gymnasium import spaces

from stkzoo._checks import check_name, check_type, shortened
from stkzoo.agent_names import by_agent
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import EXTRAS, extras_of, kart_observation_space

#: Wraps the environment of one kart: a :class:`View`, a wrapper class or a function.
ViewFactory: TypeAlias = Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]

#: All views by name. Each has a Gymnasium id; ``stkzoo.register_view`` adds views.
VIEWS: dict[str, ViewFactory] = {}

#: Views that need rendering. Environments support them; drivers do not.
CAMERA_VIEWS: dict[str, ViewFactory] = {}

_SHOWN = {"ground": "the ground", "motion": "how the other karts move", "standing": "the standing"}


@dataclass(frozen=True, slots=True)
class View:
    """How an agent observes and acts.

    Attributes:
        name: name of the view and of its Gymnasium id.
        description: one-line description.
        wrappers: wrappers around the ``full`` view, the innermost first.
        needs: requirements beyond the ``full`` view: ``"ground"``, the ground ahead; ``"motion"``,
            the motion of the other karts; ``"standing"``, rank, progress and rivals; ``"camera"``.
        options: arguments of the wrappers by name (:func:`options_of`); each wrapper gets those
            that it accepts.
    """

    name: str
    description: str
    wrappers: tuple[ViewFactory, ...] = ()
    needs: frozenset[str] = frozenset()
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __call__(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """Wraps an environment.

        Raises:
            ConfigError: the environment does not meet the view's needs, or an option is invalid.
        """
        missing = sorted(self._own_extras() - extras_of(env.observation_space))
        if missing:
            shown, env_id = _SHOWN[missing[0]], f"supertuxkart/{self.name}-v0"
            raise ConfigError(
                f"the {self.name} view needs an environment that observes {shown}. Choose "
                f"view={self._with_its_options(self.name)!r}, and write in an agent's module "
                f"env_name = {self._with_its_options(env_id)!r}, as a literal. Found "
                f"{shortened(env.observation_space, 200)}"
            )
        for wrapper in self.wrappers:
            names = self.options.keys() & options_of(wrapper)
            options = {name: self.options[name] for name in names}
            if isinstance(wrapper, View):
                env = _with_options(wrapper, options)(env)
            else:
                make: Callable[..., gym.Env[Any, Any]] = wrapper
                env = make(env, **options)
        return env

    @property
    def extras(self) -> frozenset[str]:
        """Entries of the wrapped observations beyond those of ``full``."""
        return self._own_extras().union(*map(extras_for, self.wrappers))

    def _own_extras(self) -> frozenset[str]:
        motion = ["motion"] if self.options.get("karts_motion") else []
        return self.needs.intersection(EXTRAS).union(motion)

    def _with_its_options(self, name: str) -> object:
        return (name, dict(self.options)) if self.options else name


def views() -> dict[str, ViewFactory]:
    """Returns all views by name, built-in and registered ones."""
    return {**VIEWS, **CAMERA_VIEWS}


def options_of(view: ViewFactory) -> tuple[str, ...]:
    """Returns the names of a view's options: its wrappers' parameters except the environment.

    The names are read from the signatures. For a :class:`View`, they include the parameters of all
    its wrappers.
    """
    if isinstance(view, View):
        names = (name for wrapper in view.wrappers for name in options_of(wrapper))
        return tuple(dict.fromkeys(names))
    if isinstance(view, partial):
        return options_of(view.func)
    is_class = isinstance(view, type)
    signature = inspect.signature(view.__init__ if is_class else view)
    named = inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY
    parameters = list(signature.parameters.values())[2 if is_class else 1 :]
    return tuple(parameter.name for parameter in parameters if parameter.kind in named)


def extras_for(view: ViewFactory) -> frozenset[str]:
    """Returns the names from :data:`stkzoo.mdp.spaces.EXTRAS` that a view observes.

    A function requests them with a true attribute ``sees_ground`` or ``sees_motion``.
    """
    if isinstance(view, View):
        return view.extras
    return frozenset(extra for extra in EXTRAS if getattr(view, f"sees_{extra}", False))


def base_space(view: ViewFactory, use_ai: bool = False) -> spaces.Dict:
    """Returns a new space of the observations that a view wraps: ``full`` and the view's needs.

    Args:
        view: the view.
        use_ai: whether the game's AI drives and observations include its ``action``.
    """
    return kart_observation_space(use_ai, extras_for(view))


def full_with(extras: Collection[str]) -> View:
    """Returns the ``full`` view with additional :data:`stkzoo.mdp.spaces.EXTRAS`."""
    return View("full", "``full``, and more.", needs=frozenset(extras))


def find_view(choice: object) -> ViewFactory:
    """Returns the chosen view.

    Args:
        choice: a view's name, a function that wraps a Gymnasium environment, or a pair of either
            and a mapping of options, such as ``("simple", {"state_items": 3})``.

    Raises:
        ConfigError: the choice has another type, or the name or an option does not exist.
    """
    if isinstance(choice, (tuple, list)) and len(choice) == 2:
        return _with_options(find_view(choice[0]), choice[1])
    if isinstance(choice, str):
        known = views()
        check_name("view", choice, known)
        return known[choice]
    if callable(choice):
        return choice
    raise ConfigError(
        f"view is {shortened(choice, 40)}, expected a name in stkzoo.views(), a function that "
        "wraps a gym.Env, a pair such as ('simple', {'state_items': 3}), or a dict by agent"
    )


def views_of_agents(choice: object, agents: Sequence[str]) -> dict[str, ViewFactory]:
    """Returns the view of every agent.

    Args:
        choice: a choice for :func:`find_view`, or a mapping from agents to choices. Agents without
            an entry get ``full``.
        agents: ids of all agents.

    Raises:
        ConfigError: a view or an agent does not exist.
    """
    if not isinstance(choice, Mapping):
        return dict.fromkeys(agents, find_view(choice))
    chosen = {agent: find_view(view) for agent, view in by_agent(choice, agents).items()}
    return {**dict.fromkeys(agents, VIEWS["full"]), **chosen}


def _with_options(view: ViewFactory, options: Any) -> ViewFactory:
    """Returns the view with some options changed."""
    if not isinstance(view, View):
        name = getattr(view, "__name__", type(view).__name__)
        view = View(name, "A function with options.", (view,))
    expected = "a mapping such as {'state_items': 3}"
    check_type(f"options of the {view.name} view", options, Mapping, expected)
    known = options_of(view)
    for name in options:
        if not known:
            raise ConfigError(f"the {view.name} view has no options; {name!r} came")
        check_name("option", name, known, f" of the {view.name} view")
    return replace(view, options={**view.options, **options})
