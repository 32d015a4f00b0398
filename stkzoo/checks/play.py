"""Races as the checks play them: every step with all that went in and came out."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from pettingzoo import ParallelEnv

from stkzoo.checks.failure import CheckFailed

__all__ = ["PARTS", "Policy", "RandomPolicy", "Step", "play"]

Env: TypeAlias = ParallelEnv[Any, Any, Any]

#: What ``step`` returns, in its order.
PARTS = ("observations", "rewards", "terminations", "truncations", "infos")

#: An episode that is longer than this has no end.
_MAX_STEPS = 20_000


@dataclass(frozen=True, slots=True)
class Step:
    """One ``reset`` or ``step`` of an environment.

    Attributes:
        number: 0 for the reset, then 1, 2, ...
        acting: the agents before it; those that the reset brought, for the reset.
        actions: what was passed in, by agent.
        observations: by agent, as for the other parts; a reset has no rewards and ends.
        rewards: by agent.
        terminations: by agent.
        truncations: by agent.
        infos: by agent.
        agents: the agents after it.
    """

    number: int
    acting: tuple[Any, ...]
    actions: Mapping[Any, Any]
    observations: dict[Any, Any]
    rewards: dict[Any, Any] = field(default_factory=dict)
    terminations: dict[Any, Any] = field(default_factory=dict)
    truncations: dict[Any, Any] = field(default_factory=dict)
    infos: dict[Any, Any] = field(default_factory=dict)
    agents: tuple[Any, ...] = ()

    @property
    def parts(self) -> dict[str, dict[Any, Any]]:
        """What came out, by the names of :data:`PARTS`."""
        names = ("observations", "infos") if self.number == 0 else PARTS
        return {name: getattr(self, name) for name in names}

    def is_end_of(self, agent: Any) -> bool:
        """Whether the agent was terminated or truncated here."""
        return bool(self.terminations.get(agent) or self.truncations.get(agent))


#: Chooses the actions that follow a step.
Policy: TypeAlias = Callable[[Step], Mapping[Any, Any]]


class RandomPolicy:
    """Samples from copies of the action spaces, so that nobody else's samples change.

    Args:
        env: the environment.
        seed: of the samples.
        with_departed: also send actions for agents that have left.
    """

    def __init__(self, env: Env, seed: int = 0, with_departed: bool = False) -> None:
        self._with_departed = with_departed
        self._spaces = {}
        for number, agent in enumerate(env.possible_agents):
            self._spaces[agent] = space = copy.deepcopy(env.action_space(agent))
            space.seed(1000 * seed + number)

    def __call__(self, step: Step) -> dict[Any, Any]:
        """Actions by agent."""
        agents = self._spaces if self._with_departed else step.agents
        return {agent: self._spaces[agent].sample() for agent in agents}


def play(
    env: Env,
    seed: int | None,
    *,
    max_steps: int | None = None,
    policy: Policy | None = None,
    options: dict[str, Any] | None = None,
) -> Iterator[Step]:
    """Resets an environment and steps it to its end.

    Args:
        env: the environment.
        seed: for ``reset``.
        max_steps: stop after so many steps.
        policy: random actions of a fixed seed by default.
        options: for ``reset``.

    Yields:
        The reset and every step.

    Raises:
        CheckFailed: what came back is not of the API's form, or there is no end.
    """
    policy = policy or RandomPolicy(env)
    observations, infos = _dicts("reset", env.reset(seed=seed, options=options), 2)
    agents = tuple(env.agents)
    step = Step(0, agents, {}, observations, infos=infos, agents=agents)
    yield step
    while step.agents and step.number != max_steps:
        if step.number == _MAX_STEPS:
            raise CheckFailed(
                f"the episode has no end: {', '.join(map(repr, step.agents))} still act after "
                f"{_MAX_STEPS} steps; give the environment a limit (max_cycles)"
            )
        actions = policy(step)
        results = _dicts("step", env.step(dict(actions)), len(PARTS))
        parts = dict(zip(PARTS, results, strict=True))
        step = Step(step.number + 1, step.agents, actions, agents=tuple(env.agents), **parts)
        yield step


def _dicts(method: str, result: Any, count: int) -> tuple[dict[Any, Any], ...]:
    if not isinstance(result, tuple) or len(result) != count:
        what = f"{len(result)} values" if isinstance(result, tuple) else type(result).__name__
        raise CheckFailed(f"{method}() returned {what}, expected a tuple of {count} dicts")
    for number, part in enumerate(result):
        if not isinstance(part, dict):
            raise CheckFailed(
                f"{method}() returned a {type(part).__name__} in place {number}, expected a "
                "dict by agent"
            )
    return result
