"""Learned drivers in a race: policies over plans, ensembles, and networks without plans."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from stkzoo._reading import load_json, reading
from stkzoo._schema import matching
from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.agents.planning.parameters import DriverParameters

from .action_filter import ActionFilter
from .ensemble import EnsemblePolicy, members_of
from .mlp import MlpDriver, is_network
from .policy import RacingPolicy, check_shapes
from .weights import load_weights

#: Policies over plans, ensembles, and networks without plans.
Policy = RacingPolicy | EnsemblePolicy | MlpDriver

#: Names of an agent's files.
CARD, WEIGHTS = "card.json", "weights.safetensors"


def read_policy(folder: str | Path) -> Policy:
    """Reads the policy of an agent's folder and verifies it against the card.

    Raises:
        ConfigError: a file is missing or damaged, or the weights are not a policy.
    """
    file = Path(folder) / WEIGHTS
    card = read_card(folder)
    weights = load_weights(file, card.sha256)
    networks, policies = members_of(weights, repr(str(file)))
    if networks or policies:
        return EnsemblePolicy(networks, card.ensemble_weight, policies)
    return policy_of(weights, str(file))


def policy_of(weights: Mapping[str, FloatArray], name: str) -> RacingPolicy | MlpDriver:
    """Returns the policy with the given weights.

    Args:
        weights: arrays by name.
        name: name of the weights in error messages.

    Raises:
        ConfigError: the weights are not a policy.
    """
    if is_network(weights):
        return MlpDriver(weights, repr(name))
    check_shapes(weights, name)
    return RacingPolicy(weights)


def new_state(folder: str | Path) -> PlanDriver | ActionFilter:
    """Returns the driver's state for one race.

    Args:
        folder: folder of the agent.

    Raises:
        ConfigError: see :func:`read_policy` and :func:`read_numbers`.
    """
    policy = read_policy(folder)
    if isinstance(policy, MlpDriver):
        card = read_card(folder)
        return ActionFilter(
            1, policy.hold, recovers=card.recovers, samples=card.samples, unit=policy.unit
        )
    return PlanDriver(1, read_numbers(folder))


def read_numbers(folder: str | Path) -> DriverParameters:
    """Returns the plan parameters on an agent's card, with which it was trained.

    Raises:
        ConfigError: the card is missing or damaged.
    """
    file, rules = str(Path(folder) / CARD), read_card(folder).rules
    what = f"the rules on {file!r} are not those of this version"
    with reading(what, "a card that this version of stkzoo wrote"):
        return DriverParameters.from_json(rules)


@dataclass(frozen=True, slots=True)
class AgentCard:
    """What a driver needs from the ``card.json`` of its folder.

    Attributes:
        sha256: digest of the weights.
        ensemble_weight: weight of the networks in an ensemble, unchecked;
            :class:`~stkzoo.agents.pretrained.ensemble.EnsemblePolicy` checks it.
        rules: parameters of the plans, unchecked.
        runs: the training runs, for the cards of ensembles with this driver.
        recovers: whether stuck karts of a network without plans free themselves.
        samples: whether such a network samples its choices, or takes the most likely ones.
    """

    sha256: Annotated[str, matching("[0-9a-f]{64}")]
    ensemble_weight: Any = None
    rules: Any = None
    runs: list[dict[str, Any]] = field(default_factory=list)
    recovers: bool = True
    samples: bool = False


def read_card(folder: str | Path) -> AgentCard:
    """Reads the card of an agent's folder.

    Raises:
        ConfigError: the card is missing or damaged.
    """
    file = Path(folder) / CARD
    with reading(
        f"{str(file)!r} is no card of a learned agent", "a card of this version of stkzoo"
    ):
        return load_json(file, AgentCard)


def functions_in(file: str) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """Returns the functions of an agent's module.

    Args:
        file: ``__file__`` of the module, which is in the agent's folder.

    Returns:
        ``create_state``, ``get_actor`` and ``get_batch_actor``.
    """
    return partial(new_state, Path(file).parent), make_actor, make_batch_actor


def make_actor(
    module_dir: str | Path, observation_space: Any = None, action_space: Any = None
) -> Callable[[Any, Any], Any]:
    """Returns the actor of an agent, for the view ``full``, or ``racing`` if it has no plans.

    Args:
        module_dir: folder of the agent.
        observation_space: ignored; ``get_actor`` receives it.
        action_space: ignored; ``get_actor`` receives it.

    Raises:
        ConfigError: see :func:`read_policy`.
    """
    del observation_space, action_space
    policy = read_policy(module_dir)
    return lambda state, observation: state.drive(observation, policy.best)


def make_batch_actor(
    module_dir: str | Path,
) -> Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]:
    """Returns a function that drives several karts of an agent at once, like :func:`make_actor`.

    Args:
        module_dir: folder of the agent.

    Raises:
        ConfigError: see :func:`read_policy`.
    """
    policy = read_policy(module_dir)
    return lambda states, seen: type(states[0]).drive_together(states, seen, policy.best)
