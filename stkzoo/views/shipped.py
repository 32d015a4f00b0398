"""The shipped views, each a declared value: a name and the wrappers around the ``full`` view.

To add a view, add a :class:`View` to :data:`VIEWS`. Its Gymnasium id, its place in vector
environments and its tests come with it. Agents that share a view share its work.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

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

#: Wraps the environment of one kart. :class:`View` values, wrapper classes and functions do.
ViewFactory: TypeAlias = Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]]


@dataclass(frozen=True, slots=True)
class View:
    """What an agent observes and how it acts.

    Attributes:
        name: of the view, and of its Gymnasium id.
        description: one line about it.
        wrappers: around the ``full`` view, the innermost first.
        needs: what the race has to offer beside that: ``"ground"``, what is beside the road, or
            ``"camera"``.
    """

    name: str
    description: str
    wrappers: tuple[ViewFactory, ...] = ()
    needs: frozenset[str] = frozenset()

    def __call__(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """The environment, wrapped.

        Raises:
            ConfigError: it does not offer what the view needs.
        """
        if self.sees_ground and not shows_ground(env.observation_space):
            raise ConfigError(
                f"the {self.name} view goes around an environment that shows the ground. Choose "
                f"view={self.name!r}, and write in an agent's module env_name = "
                f"'supertuxkart/{self.name}-v0' as it stands here. Found "
                f"{env.observation_space!r:.200}"
            )
        for wrapper in self.wrappers:
            env = wrapper(env)
        return env

    @property
    def sees_ground(self) -> bool:
        """Whether the view is around observations that tell of the ground."""
        return "ground" in self.needs


_SIMPLE = (ConstantSizedObservations, PolarObservations)
_MULTIDISCRETE = (*_SIMPLE, DiscreteActionsWrapper, FlattenerWrapper)
_DISCRETE = (*_MULTIDISCRETE, FlattenMultiDiscreteActions)
_CONTINUOUS = (*_SIMPLE, OnlyContinuousActionsWrapper, FlattenerWrapper)

_SHIPPED = (
    View("full", "Everything a kart sees, in lists of varying length; the game's own actions."),
    View(
        "ground",
        "``full``, and what is beside the road ahead: walls, drops, what slows, zippers.",
        needs=frozenset({"ground"}),
    ),
    View(
        "simple",
        "The nearest five items, karts and track segments, in polar coordinates.",
        _SIMPLE,
    ),
    View(
        "flattened",
        "``simple`` as one continuous and one discrete vector, both ways.",
        (*_SIMPLE, FlattenerWrapper),
    ),
    View(
        "flattened_continuous_actions",
        "``flattened``, acting by acceleration and steering alone.",
        _CONTINUOUS,
    ),
    View(
        "flattened_multidiscrete",
        "``flattened``, with acceleration and steering in steps.",
        _MULTIDISCRETE,
    ),
    View(
        "flattened_discrete",
        "``flattened_multidiscrete`` with one number for the whole action.",
        _DISCRETE,
    ),
    View(
        "box_discrete",
        "``flattened_discrete`` with all observations in one vector.",
        (*_DISCRETE, JoinedObservations),
    ),
    View(
        "box_continuous",
        "``flattened_continuous_actions`` with all observations in one vector.",
        (*_CONTINUOUS, JoinedObservations),
    ),
    View(
        "masked_discrete",
        "``box_discrete``, and a mask of the actions that can do something.",
        (*_DISCRETE, ActionMasks, JoinedObservations),
    ),
    View(
        "racing",
        "The road ahead and what is near as one vector of fixed size; acting by a few choices.",
        (RacingObservations, RacingActions),
    ),
    View(
        "control",
        "``simple``, acting by speed [m/s] and steering angle [rad].",
        (ControlView(),),
    ),
    View(
        "flattened_control",
        "``flattened``, acting by speed and steering angle, each from -1 to 1.",
        (ControlView(observe="flattened", normalize_act=True),),
    ),
)

#: The known views, from which the Gymnasium ids are made; ``stkzoo.register_view`` adds to them.
VIEWS: dict[str, ViewFactory] = {view.name: view for view in _SHIPPED}

#: Views that need an environment which can draw: those of this package, but no agent's alone.
CAMERA_VIEWS: dict[str, ViewFactory] = {
    "camera": View(
        "camera",
        "``flattened_discrete``, and the picture of the kart's camera, 84 by 84 pixels.",
        (*_DISCRETE, CameraObservations),
        needs=frozenset({"camera"}),
    )
}


def sees_ground(view: ViewFactory) -> bool:
    """Whether a view is around observations that tell of the ground.

    It says so by an attribute ``sees_ground`` that is true.
    """
    return bool(getattr(view, "sees_ground", False))


def views_of_agents(choice: object, agents: Sequence[str]) -> dict[str, ViewFactory]:
    """The view of every agent.

    Args:
        choice: a view's name, a function that wraps a Gymnasium environment, or a mapping
            from agents to these; agents that the mapping leaves out get ``full``.
        agents: all agents' ids.
    """
    if not isinstance(choice, Mapping):
        return dict.fromkeys(agents, _view(choice))
    chosen = {agent: _view(view) for agent, view in by_agent(choice, agents).items()}
    return {**dict.fromkeys(agents, VIEWS["full"]), **chosen}


def _view(choice: object) -> ViewFactory:
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
