"""An ensemble of plans, policies over plans, and networks.

Networks from self-play know how races develop; plans know the road ahead. Both give probabilities
for the choices, and the ensemble multiplies them (product of experts: Hinton, 2002).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import (
    HEADS,
    OFFSETS,
    PolicyInput,
    is_drifting,
    likeliest,
    plan_turns,
)
from stkzoo.agents.planning.plans import BRAKE as BRAKE_PLAN
from stkzoo.agents.planning.plans import DRIFT_LEFT, DRIFT_RIGHT, MANEUVERS
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import BRAKE

from .action_filter import steering
from .mlp import SPLITS, MlpDriver, log_probabilities
from .policy import RacingPolicy, check_shapes

#: Pedal, drift and side of each maneuver.
_PEDALS = np.array([BRAKE if m == BRAKE_PLAN else 0 for m in range(MANEUVERS)])
_SIDES = np.array([(m == DRIFT_RIGHT) - (m == DRIFT_LEFT) for m in range(MANEUVERS)], np.float32)
_DRIFTS = np.abs(_SIDES).astype(np.intp)
#: Prefixes of the arrays of each network and of each policy over plans in a file.
_NETWORK, _POLICY = "adviser{}.", "policy{}."


def check_ensemble_weight(weight: object) -> None:
    """Checks the weight of the networks.

    Raises:
        ConfigError: the weight is not a number of at least 0.
    """
    if not (isinstance(weight, (int, float)) and 0 <= weight < np.inf):
        raise ConfigError(
            f"ensemble_weight is {weight!r}, expected a number of 0 or more; 1 is usual"
        )


class EnsemblePolicy:
    """Chooses among plans by their worth and by the probabilities of networks.

    The logit of a maneuver with a turn is the prior's logit plus ``weight`` times the networks'
    mean log-probability of the equivalent steering, pedal and drift. The logits of nitro and fire
    are computed in the same way. The mean of the learned logits of policies over plans is added to
    the prior first.

    Args:
        networks: networks on the view ``racing``.
        weight: weight of the networks; with 0, they do not count.
        policies: policies over plans.

    Raises:
        ConfigError: see :func:`check_ensemble_weight`.
    """

    def __init__(
        self,
        networks: Sequence[MlpDriver],
        weight: float,
        policies: Sequence[RacingPolicy] = (),
    ) -> None:
        check_ensemble_weight(weight)
        self.networks, self.weight, self.policies = tuple(networks), weight, tuple(policies)

    def best(self, view: PolicyInput) -> IntArray:
        """Returns the most likely choices ``(A, 4)``, in the form of a policy over plans."""
        logits = self._plan_logits(view)
        if not self.networks:
            return likeliest(logits)
        opinions = log_probabilities(
            np.array([network.logits(view.inputs) for network in self.networks])
        )
        steer, pedal, drift, nitro, fire = np.split(opinions.mean(axis=0), SPLITS, axis=-1)
        begin, turn, *buttons = (logits[:, head] for head in HEADS)
        rows = np.arange(len(begin))[:, None, None]
        liked = (
            steer[rows, _steering(view.inputs)] + (pedal[:, _PEDALS] + drift[:, _DRIFTS])[..., None]
        )
        moves = begin[..., None] + turn[:, None] + np.float32(self.weight) * liked
        best = moves.reshape(len(begin), -1).argmax(axis=1)
        presses = [
            (prior + np.float32(self.weight) * logits).argmax(axis=1)
            for prior, logits in zip(buttons, (nitro, fire), strict=True)
        ]
        choices: IntArray = np.array([*divmod(best, len(OFFSETS)), *presses]).T
        return choices

    def _plan_logits(self, view: PolicyInput) -> FloatArray:
        """Returns the prior plus the mean of the policies' learned logits."""
        if not self.policies:
            return view.prior
        learned = [policy.learned_logits(view) for policy in self.policies]
        logits: FloatArray = view.prior + np.mean(learned, axis=0)
        return logits


def _steering(inputs: FloatArray) -> IntArray:
    """Returns the steering choice for each maneuver and turn, ``(A, 4, 7)``."""
    turn = np.minimum(np.maximum(plan_turns(inputs)[..., None] + OFFSETS, -1.0), 1.0)
    sides = _SIDES[:, None]
    begins = (sides != 0) & ~is_drifting(inputs)[:, None, None]
    return steering(sides, turn, begins)


def join_members(
    networks: Iterable[Mapping[str, FloatArray]], policies: Iterable[Mapping[str, FloatArray]]
) -> dict[str, FloatArray]:
    """Returns the arrays of networks and of policies over plans with names for a single file."""
    return {
        prefix.format(number) + name: array
        for prefix, members in ((_NETWORK, networks), (_POLICY, policies))
        for number, weights in enumerate(members)
        for name, array in weights.items()
    }


def members_of(
    weights: Mapping[str, FloatArray], name: str
) -> tuple[list[MlpDriver], list[RacingPolicy]]:
    """Returns the networks and policies from :func:`join_members`; empty lists if there are none.

    Args:
        weights: arrays of a file.
        name: name of the file in error messages.

    Raises:
        ConfigError: an array set is not a network on the view ``racing`` or a policy over plans.
    """
    networks, policies = split_members(weights)
    for number, policy in enumerate(policies):
        check_shapes(policy, f"policy {number} of {name}")
    drivers = [MlpDriver(arrays, f"network {n} of {name}") for n, arrays in enumerate(networks)]
    if any(driver.unit for driver in drivers):
        raise ConfigError(f"{name} has a recurrent network, expected networks without memory")
    return drivers, [RacingPolicy(policy) for policy in policies]


def split_members(
    weights: Mapping[str, FloatArray],
) -> tuple[list[dict[str, FloatArray]], list[dict[str, FloatArray]]]:
    """Returns the arrays of each network and each policy of :func:`join_members`."""
    return _members(weights, _NETWORK), _members(weights, _POLICY)


def _members(weights: Mapping[str, FloatArray], pattern: str) -> list[dict[str, FloatArray]]:
    members: list[dict[str, FloatArray]] = []
    while True:
        prefix = pattern.format(len(members))
        member = {n.removeprefix(prefix): a for n, a in weights.items() if n.startswith(prefix)}
        if not member:
            return members
        members.append(member)
