"""Views by name: what an agent observes and how it acts.

A view is a function from a Gymnasium environment to a wrapped one. It is applied to
each agent's side of the race, and agents that share a view share its work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym

from stkzoo.agent_names import by_agent
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.mdp.spaces import shows_ground
from stkzoo.wrappers import (
    CameraObservations,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    JoinedObservations,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)
from stkzoo.wrappers.control import ControlView
from stkzoo.wrappers.marl import ActionMasks
from stkzoo.wrappers.racing import RacingActions, RacingObservations

__all__ = ["CAMERA_VIEWS", "VIEWS", "View", "sees_ground", "views_of_agents"]

View = Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]


def full(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """Everything a kart sees, in lists of varying length; the game's own actions."""
    return env


def ground(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``full``, and what is beside the road ahead: walls, drops, what slows, zippers.

    Raises:
        ConfigError: the environment does not show that.
    """
    if not shows_ground(env.observation_space):
        raise ConfigError(
            "the ground view goes around an environment that shows the ground, but found "
            f"{env.observation_space!r}; choose view='ground', and write in an agent's module "
            "env_name = 'supertuxkart/ground-v0' as it stands here"
        )
    return env


# What sees_ground() looks for; to mypy functions have no attributes of their own.
ground.sees_ground = True  # type: ignore[attr-defined]


def simple(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """The nearest five items, karts and track segments, in polar coordinates."""
    return PolarObservations(ConstantSizedObservations(env))


def flattened(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``simple`` as one continuous and one discrete vector, both ways."""
    return FlattenerWrapper(simple(env))


def flattened_continuous_actions(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened``, acting by acceleration and steering alone."""
    return FlattenerWrapper(OnlyContinuousActionsWrapper(simple(env)))


def flattened_multidiscrete(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened``, with acceleration and steering in steps."""
    return FlattenerWrapper(DiscreteActionsWrapper(simple(env)))


def flattened_discrete(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened_multidiscrete`` with one number for the whole action."""
    return FlattenMultiDiscreteActions(flattened_multidiscrete(env))


def box_discrete(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened_discrete`` with all observations in one vector."""
    return JoinedObservations(flattened_discrete(env))


def box_continuous(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened_continuous_actions`` with all observations in one vector."""
    return JoinedObservations(flattened_continuous_actions(env))


def masked_discrete(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``box_discrete``, and a mask of the actions that can do something."""
    return JoinedObservations(ActionMasks(flattened_discrete(env)))


def racing(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """The road ahead and what is near as one vector of fixed size; acting by a few choices."""
    return RacingActions(RacingObservations(env))


def camera(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened_discrete``, and the picture of the kart's camera, 84 by 84 pixels."""
    return CameraObservations(flattened_discrete(env))


def control(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``simple``, acting by speed [m/s] and steering angle [rad]; see :class:`ControlView`."""
    return ControlView()(env)


def flattened_control(env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
    """``flattened``, acting by speed and steering angle, each from -1 to 1."""
    return ControlView(observe="flattened", normalize_act=True)(env)


#: The known views, from which the Gymnasium ids are made; ``stkzoo.register_view`` adds to them.
VIEWS: dict[str, View] = {
    view.__name__: view
    for view in (
        full,
        ground,
        simple,
        flattened,
        flattened_continuous_actions,
        flattened_multidiscrete,
        flattened_discrete,
        box_discrete,
        box_continuous,
        masked_discrete,
        racing,
        control,
        flattened_control,
    )
}

#: Views that need an environment which can draw: those of this package, but no agent's alone.
CAMERA_VIEWS: dict[str, View] = {"camera": camera}


def sees_ground(view: View) -> bool:
    """Whether a view is around observations that tell of the ground.

    It says so by an attribute ``sees_ground`` that is true.
    """
    return bool(getattr(view, "sees_ground", False))


def views_of_agents(choice: object, agents: Sequence[str]) -> dict[str, View]:
    """The view of every agent.

    Args:
        choice: a view's name, a function that wraps a Gymnasium environment, or a mapping
            from agents to these; agents that the mapping leaves out get ``full``.
        agents: all agents' ids.
    """
    if not isinstance(choice, Mapping):
        return dict.fromkeys(agents, _view(choice))
    chosen = {agent: _view(view) for agent, view in by_agent(choice, agents).items()}
    return {**dict.fromkeys(agents, full), **chosen}


def _view(choice: object) -> View:
    if isinstance(choice, str):
        known = {**VIEWS, **CAMERA_VIEWS}
        if choice not in known:
            raise unknown_name("view", choice, known)
        return known[choice]
    if callable(choice):
        return choice
    raise ConfigError(
        f"view is {choice!r}, expected one of {', '.join(VIEWS)}, a function that wraps a "
        "gym.Env, or a mapping from agents to these"
    )
