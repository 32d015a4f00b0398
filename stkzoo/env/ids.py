"""Registration of environment ids with Gymnasium and PettingZoo."""

from __future__ import annotations

import warnings

import gymnasium
import pettingzoo

from stkzoo.errors import ConfigError
from stkzoo.views import SHIPPED, VIEWS, find_view, views

MAX_EPISODE_STEPS = 1500
_NAMESPACE = "supertuxkart"


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


def register_view(name: str, view: object) -> None:
    """Adds a view, for ``view="<name>"`` and ``gym.make("supertuxkart/<name>-v0")``.

    Args:
        name: name of the view. It replaces a view that you registered under this name.
        view: function that wraps a Gymnasium environment, such as a :class:`gymnasium.Wrapper`
            class. Its other parameters are the view's options. Or a known view with options:
            ``("simple", {"state_items": 3})``.

    Raises:
        ConfigError: the name is that of a built-in view or not a valid name, or ``view`` is not a
            view.
    """
    if not isinstance(name, str) or not name.isidentifier():
        raise ConfigError(f"view name is {name!r}, expected letters, digits and underscores")
    if name in {shipped.name for shipped in SHIPPED}:
        raise ConfigError(f"view {name!r} is stkzoo's own; choose another name")
    added = find_view(view)
    if name not in VIEWS:
        _register_view_id(name)
    VIEWS[name] = added


def _register_view_id(name: str) -> None:
    gymnasium.register(
        id=f"{_NAMESPACE}/{name}-v0",
        entry_point="stkzoo.env.gymnasium_api:STKRaceEnv",
        vector_entry_point="stkzoo.env.vector:single_kart_races",
        kwargs={"view": name},
        max_episode_steps=MAX_EPISODE_STEPS,
    )


def warn_of_time_limit(max_cycles: int | None, limit: int | None) -> None:
    """Warns if the time limit of an id is shorter than the ``max_cycles`` of an episode."""
    if max_cycles is not None and limit is not None and limit < max_cycles:
        warnings.warn(
            f"max_cycles is {max_cycles}, but gym.make truncates episodes of this id after {limit} "
            f"steps unless you pass max_episode_steps={max_cycles}",
            stacklevel=3,
        )
