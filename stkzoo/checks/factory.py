"""What is checked: a function that makes an environment, with the keywords that it takes."""

from __future__ import annotations

import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Any, TypeAlias

from pettingzoo import ParallelEnv

from stkzoo.config import AgentSpec
from stkzoo.errors import ConfigError

__all__ = ["EnvFactory", "bind", "load_factory", "short_race", "takes", "whole_race"]

#: Makes a fresh environment at every call.
EnvFactory: TypeAlias = Callable[..., ParallelEnv[Any, Any, Any]]

#: A track on which the game's own drivers need some 300 steps.
_TRACK = "olivermath"
_SHORT_RACE_STEPS = 60
_WHOLE_RACE_STEPS = 380


def load_factory(target: str) -> EnvFactory:
    """The factory that ``"module:callable"`` names.

    Raises:
        ConfigError: there is none of that name.
    """
    module_name, colon, name = target.partition(":")
    if not (module_name and colon and name):
        raise ConfigError(
            f"the environment is {target!r}, expected module:callable, such as "
            "stkzoo.race_v0:parallel_env"
        )
    try:
        factory = functools.reduce(getattr, name.split("."), importlib.import_module(module_name))
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"the environment {target!r} cannot be loaded: {error}; run the command from a "
            "folder, or with a PYTHONPATH, from which the module can be imported"
        ) from error
    if not callable(factory):
        raise ConfigError(
            f"{target!r} is {factory!r}, expected a function that makes a ParallelEnv"
        )
    made: EnvFactory = factory
    return made


def takes(make_env: EnvFactory, name: str) -> bool:
    """Whether the factory names a keyword in its signature and nobody has bound it yet."""
    return name in _parameters(make_env) and name not in _bound(make_env)


def bind(make_env: EnvFactory, name: str, value: Any) -> EnvFactory:
    """The factory with one keyword chosen.

    Raises:
        ConfigError: the factory does not take it.
    """
    parameters = _parameters(make_env)
    if name not in parameters and _VAR_KEYWORD not in map(_kind, parameters.values()):
        raise ConfigError(
            f"the environment's factory takes no {name!r}; it takes: {', '.join(parameters)}"
        )
    return functools.partial(make_env, **{name: value})


def short_race(make_env: EnvFactory) -> EnvFactory:
    """The factory, for 60 steps of three agents that act, as far as it takes such keywords."""
    return _fitted(make_env, track=_TRACK, num_kart=3, max_cycles=_SHORT_RACE_STEPS)


def whole_race(make_env: EnvFactory) -> EnvFactory:
    """The factory, for a race in which agents end at different times, as far as it can be.

    Where it takes the keywords of :func:`stkzoo.race_v0.parallel_env`, one agent acts at
    random, two are driven by the game to the finish, and a fourth kart is a bot.
    """
    options: dict[str, Any] = {"track": _TRACK, "max_cycles": _WHOLE_RACE_STEPS}
    if takes(make_env, "agents") and takes(make_env, "num_kart"):
        options["num_kart"] = 4
        options["agents"] = [AgentSpec(), AgentSpec(use_ai=True), AgentSpec(use_ai=True)]
    return _fitted(make_env, **options)


_VAR_KEYWORD = inspect.Parameter.VAR_KEYWORD


def _kind(parameter: inspect.Parameter) -> Any:
    return parameter.kind


def _parameters(make_env: EnvFactory) -> dict[str, inspect.Parameter]:
    try:
        return dict(inspect.signature(make_env).parameters)
    except (TypeError, ValueError):  # some callables do not tell
        return {}


def _bound(make_env: EnvFactory) -> frozenset[str]:
    return frozenset(make_env.keywords if isinstance(make_env, functools.partial) else ())


def _fitted(make_env: EnvFactory, **options: Any) -> EnvFactory:
    known = {name: value for name, value in options.items() if takes(make_env, name)}
    return functools.partial(make_env, **known)
