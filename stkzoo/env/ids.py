"""Registration of environment ids with Gymnasium and PettingZoo, and the ids' time limit."""

from __future__ import annotations

import inspect
import sys
import warnings
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import gymnasium
import pettingzoo
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeLimit

from stkzoo._checks import check_name
from stkzoo.errors import ConfigError
from stkzoo.views import SHIPPED, VIEWS, ViewFactory, find_view, views

MAX_EPISODE_STEPS = 1500
_NAMESPACE = "supertuxkart"
_SHIPPED = frozenset(view.name for view in SHIPPED)


def register_ids() -> None:
    """Registers all ids; ``import stkzoo`` calls it."""
    register_gymnasium_ids()
    if hasattr(pettingzoo, "register"):  # from PettingZoo 1.27
        pettingzoo.register("parallel", f"{_NAMESPACE}/race-v0", "stkzoo.race_v0:parallel_env")
        pettingzoo.register("aec", f"{_NAMESPACE}/race-v0", "stkzoo.race_v0:env")


def register_gymnasium_ids() -> None:
    """Registers the Gymnasium ids; warns once if it replaces another package's ids."""
    names = (*views(), "multi-full")
    replaced = [gymnasium.registry.pop(f"{_NAMESPACE}/{name}-v0", None) for name in names]
    owners = {str(spec.entry_point).partition(".")[0] for spec in replaced if spec} - {"stkzoo"}
    for owner in sorted(owners):
        warnings.warn(
            f"{owner} was imported before stkzoo.compat: the ids {_NAMESPACE}/... are stkzoo's "
            f"from now on, but names that were imported from {owner} are not. To use stkzoo's "
            f"names too, write `import stkzoo.compat` above the first import of {owner}.",
            stacklevel=2,
        )
    for name in views():
        _register_view_id(name)
    gymnasium.register(
        id=f"{_NAMESPACE}/multi-full-v0",
        entry_point="stkzoo.env.gymnasium_api:STKRaceMultiEnv",
        max_episode_steps=MAX_EPISODE_STEPS,
    )


def register_view(name: str, view: object, *, replace: bool = False) -> None:
    """Adds a view, for ``view="<name>"`` and ``gym.make("supertuxkart/<name>-v0")``.

    You may register the same view again, for example when a notebook cell runs twice.

    Args:
        name: name of the view.
        view: function that wraps a Gymnasium environment, such as a :class:`gymnasium.Wrapper`
            class. Its other parameters are the view's options. Or a known view with options:
            ``("simple", {"state_items": 3})``.
        replace: whether to replace an existing custom view of that name.

    Raises:
        ConfigError: the name is taken or not a valid name, or ``view`` is not a view.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigError(f"view name is {name!r}, expected letters, digits and underscores")
    _refuse_shipped(name, "choose another name")
    added = find_view(view)
    if name in VIEWS and not (replace or _is_same(added, VIEWS[name])):
        raise ConfigError(
            f"view {name!r} exists already and is {VIEWS[name]!r}; choose another name, or pass "
            "replace=True"
        )
    if name not in VIEWS:
        _register_view_id(name)
    VIEWS[name] = added


def unregister_view(name: str) -> None:
    """Removes a view that :func:`register_view` added, and its id.

    Args:
        name: name of the view.

    Raises:
        ConfigError: no view has that name, or the view is built in.
    """
    _refuse_shipped(name, "it stays")
    check_name("registered view", name, VIEWS.keys() - _SHIPPED)
    del VIEWS[name]
    gymnasium.registry.pop(f"{_NAMESPACE}/{name}-v0", None)


def _refuse_shipped(name: str, remedy: str) -> None:
    if name in _SHIPPED:
        raise ConfigError(f"view {name!r} is stkzoo's own; {remedy}")


def _is_same(view: ViewFactory, other: ViewFactory) -> bool:
    """Whether two views are equal, or come from the same definition run twice."""
    names = [
        (entry.__module__, getattr(entry, "__qualname__", id(entry))) for entry in (view, other)
    ]
    return view == other or names[0] == names[1]


def _register_view_id(name: str) -> None:
    gymnasium.register(
        id=f"{_NAMESPACE}/{name}-v0",
        entry_point="stkzoo.env.gymnasium_api:STKRaceEnv",
        vector_entry_point="stkzoo.env.vector:single_kart_races",
        kwargs={"view": name},
        max_episode_steps=MAX_EPISODE_STEPS,
    )


# ---------------------------------------------------------------------- time limit


class RaceSpec(EnvSpec):
    """A spec in which ``max_cycles``, if given, replaces the time limit of the id."""

    @classmethod
    def of(cls, spec: EnvSpec) -> RaceSpec:
        """Returns a spec with the same fields."""
        values = {field.name: getattr(spec, field.name) for field in fields(spec) if field.init}
        return cls(**values)

    @property
    def max_episode_steps(self) -> int | None:
        """Number of steps after which an episode is truncated; ``None`` for no limit."""
        is_of_id = self._limit in (None, limit_of_id(self))
        limit: int | None = self.kwargs.get("max_cycles", self._limit) if is_of_id else self._limit
        return limit

    @max_episode_steps.setter
    def max_episode_steps(self, limit: int | None) -> None:
        self._limit = limit


def limit_of_id(spec: EnvSpec) -> int | None:
    """Returns the time limit with which the id of a spec is registered, if there is one."""
    registered = gymnasium.registry.get(spec.id)
    return registered.max_episode_steps if registered else None


def follow_max_cycles(
    env: gymnasium.Env[Any, Any], has_max_cycles: bool, asked: Mapping[str, Any]
) -> None:
    """Disables the ``TimeLimit`` of an environment for an episode that has its own ``max_cycles``.

    ``gym.make`` adds the wrapper outside the environment, which cannot refer to it. So it is looked
    up among the callers: this function must be called by ``reset``.

    Args:
        env: the environment.
        has_max_cycles: whether the environment was created with ``max_cycles``, which replaces the
            limit of its id. A limit that the user gave to ``gym.make`` stays.
        asked: options of ``reset``; ``max_cycles`` replaces any limit.
    """
    if env.spec is None:
        return
    frame = inspect.currentframe()
    while frame is not None:
        caller = frame.f_locals.get("self")
        if isinstance(caller, TimeLimit) and caller.unwrapped is env:
            limit = caller._max_episode_steps
            if "max_cycles" in asked or (has_max_cycles and limit == limit_of_id(env.spec)):
                caller._elapsed_steps = -sys.maxsize  # type: ignore[assignment]
            return
        frame = frame.f_back
