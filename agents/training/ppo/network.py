"""Policy and value networks of PPO, in PyTorch for training and as arrays for acting."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.driver import HEADS, INPUT_SIZE, mirrored_inputs
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.pretrained.driver import WEIGHTS
from stkzoo.agents.pretrained.mlp import HOLD, MlpDriver
from stkzoo.agents.pretrained.policy import INPUT_CLIP, check_shapes
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import CHOICES, RESCUE, SIZE

from ..common.command import training_torch
from .rollouts import PolicyShape, Weights, critic_inputs, plan_shape, racing_shape

#: Standard deviation of returns, if they are not measured.
_VALUE_UNIT = 10.0
#: Weight of a rollout in the mean and the standard deviation of returns.
_RETURNS_RATE = 0.05
#: Largest norm of the gradient of policy or value network.
_MAX_GRADIENT = 0.5
#: Minimum standard deviation of an input, so that constant inputs are not amplified.
_LEAST_SCALE = np.float32(0.2)
#: Name of the weights of a policy's first layer in files.
_FIRST_LAYER = "mlp_extractor.policy_net.0.weight"
#: Initial biases by index of the logit, on the view ``racing``: prefer going to braking, and rarely
#: drift or call the rescue. Without them, karts stand still for most of their first races.
FIRST_BIASES = {CHOICES[0]: 1.5, CHOICES[0] + RESCUE: -3.0, sum(CHOICES[:2]): 2.0}


class ActorCritic(ABC):
    """A policy and a value network in PyTorch, with their optimizer.

    Args:
        shape: what the policy sees and chooses.
        hidden: units of the hidden layers of both.
        seed: seed of the initial weights.
        kl_coef: coefficient of the KL penalty toward the prior.

    Attributes:
        torch: the module ``torch``.
        sequence: number of successive steps that the policy learns from together.
        modules: names of the attributes that are modules with parameters.
        policy: layers of the policy.
        value: layers of the value network.
        optimizer: optimizer of both; its first parameter group is the policy's.
        kl_coef: see the argument.
        mean: mean of the value network's inputs, by which they are normalized.
        scale: factor by which they are normalized.
        returns: mean and standard deviation of returns, by which values are normalized.

    Raises:
        ConfigError: PyTorch is not installed.
    """

    #: Name in ``torch.nn`` of the module between two layers of the policy.
    activation: ClassVar[str]
    sequence: ClassVar[int] = 1
    modules: ClassVar[tuple[str, ...]] = ("policy", "value")

    def __init__(
        self, shape: PolicyShape, hidden: Sequence[int], seed: int, kl_coef: float = 0.0
    ) -> None:
        self.torch = torch = training_torch()
        torch.manual_seed(seed)
        self.shape, self.kl_coef = shape, kl_coef
        size = shape.inputs + shape.state_size
        activation = getattr(torch.nn, self.activation)
        self.policy = _make_layers(
            torch, (shape.inputs, *hidden, sum(shape.choices)), activation, 0.01
        )
        self.value = _make_layers(torch, (size, *hidden, 1), torch.nn.ReLU, 1.0)
        self.mean, self.scale = np.zeros(size, np.float32), np.ones(size, np.float32)
        self.returns = np.array([0.0, _VALUE_UNIT], np.float32)
        self.optimizer = torch.optim.Adam(
            [{"params": self.policy.parameters()}, {"params": self.value.parameters()}], eps=1e-5
        )

    @abstractmethod
    def start_from(self, weights: Weights) -> None:
        """Copies the policy in a file."""

    @abstractmethod
    def policy_weights(self) -> dict[str, FloatArray]:
        """Returns the policy as arrays for the actors and for files."""

    def policy_inputs(self, rows: npt.NDArray[np.void], central: FloatArray) -> FloatArray:
        """Returns the policy's inputs ``(N, inputs)`` in rows of a rollout.

        Args:
            rows: the rows.
            central: inputs of the value network, normalized.
        """
        del central
        inputs: FloatArray = rows["inputs"].copy()
        return inputs

    def normalize_returns(self, returns: FloatArray) -> None:  # noqa: B027 - for subclasses
        """Adapts the normalization of values to the returns of a rollout."""

    def prepare(self, seen: npt.NDArray[np.void]) -> bool:  # noqa: ARG002 - for subclasses
        """Adapts the networks to rows of the first rollout; returns whether they changed."""
        return False

    def weights(self) -> tuple[Weights, Weights]:
        """Returns the weights of policy and value network for the actors.

        The value network of the actors returns values that are not normalized.
        """
        critic, (mean, unit) = self._arrays(self.value), self.returns
        return self.policy_weights(), critic | {
            "w2": critic["w2"] * unit,
            "b2": critic["b2"] * unit + mean,
        }

    def tensors(self, rows: npt.NDArray[np.void]) -> list[Any]:
        """Returns the inputs of :meth:`evaluate` for rows of a rollout, as tensors ``(N, ...)``."""
        seen = (critic_inputs(rows) - self.mean) * self.scale
        central = np.clip(seen, -INPUT_CLIP, INPUT_CLIP, dtype=np.float32)
        inputs = self.policy_inputs(rows, central)
        arrays = inputs, central, rows["prior"].copy(), rows["choices"].copy()
        return [self.torch.from_numpy(array) for array in arrays]

    def chosen_inputs(self, inputs: Any, rows: Any, used: Any) -> Any:
        """Returns the policy's inputs in some rows, from the first tensor of :meth:`tensors`.

        Args:
            inputs: the tensor, whose rows are sequences of :attr:`sequence` successive steps.
            rows: indices of the rows, in whole sequences.
            used: bool, which of these rows to return.
        """
        return inputs[rows[used]]

    def evaluate(self, columns: Sequence[Any]) -> tuple[Any, Any, Any, Any]:
        """Evaluates the choices in rows of a rollout.

        Args:
            columns: tensors of :meth:`tensors`.

        Returns:
            Tensors ``(N,)``: log-probability of the choices, entropy of the policy [nats], its KL
                divergence from the prior, and the normalized value.
        """
        inputs, central, prior, choices = columns
        logits, log_softmax = self.policy(inputs), self.torch.log_softmax
        if self.shape.has_prior:
            logits = logits + prior
        log_probability, entropy, prior_kl = 0.0, 0.0, self.torch.zeros(1)
        for column in self.shape.columns:
            head = self.shape.heads[column]
            logs = log_softmax(logits[:, head], dim=1)
            chosen = logs.gather(1, choices[:, column : column + 1])[:, 0]
            log_probability = log_probability + chosen
            entropy = entropy - (logs.exp() * logs).sum(1)
            if self.shape.has_prior:
                apart = logs - log_softmax(prior[:, head], dim=1)
                prior_kl = prior_kl + (logs.exp() * apart).sum(1)
        return log_probability, entropy, prior_kl, self.value(central)[:, 0]

    def descend(self, loss: Any) -> None:
        """Makes a gradient step on a loss."""
        self.optimizer.zero_grad()
        loss.backward()
        for name in self.modules:
            parameters = getattr(self, name).parameters()
            self.torch.nn.utils.clip_grad_norm_(parameters, _MAX_GRADIENT)
        self.optimizer.step()

    def state(self) -> dict[str, Any]:
        """Returns everything that learning changes as tensors, for :meth:`restore`."""
        names = *self.modules, "optimizer"
        parts = {name: getattr(self, name).state_dict() for name in names}
        scales = {"mean": self.mean, "scale": self.scale, "returns": self.returns}
        return parts | {name: self.torch.from_numpy(array) for name, array in scales.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restores a :meth:`state`."""
        for name in (*self.modules, "optimizer"):
            getattr(self, name).load_state_dict(state[name])
        for name in ("mean", "scale", "returns"):
            setattr(self, name, state[name].numpy())

    def _arrays(self, layers: Any) -> dict[str, FloatArray]:
        """Returns layers in the form of :class:`~stkzoo.agents.pretrained.policy.Network`."""
        arrays = {"mean": self.mean.copy(), "scale": self.scale.copy()}
        for number, layer in enumerate(layers[::2]):
            arrays[f"w{number}"] = layer.weight.detach().numpy().T.copy()
            arrays[f"b{number}"] = layer.bias.detach().numpy().copy()
        return arrays

    def _copy(self, tensors: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> None:
        with self.torch.no_grad():
            for name, tensor in tensors.items():
                tensor.copy_(self.torch.from_numpy(arrays[name].copy()))


class PlanNetwork(ActorCritic):
    """Networks over plans; the first rollout determines how their inputs are normalized.

    Args:
        columns: choices to train.
        hidden: see :class:`ActorCritic`.
        seed: see :class:`ActorCritic`.
        kl_coef: see :class:`ActorCritic`.
    """

    activation = "ReLU"

    def __init__(
        self, columns: Sequence[int], hidden: Sequence[int], seed: int, kl_coef: float = 0.0
    ) -> None:
        super().__init__(plan_shape(columns), hidden, seed, kl_coef)
        self._is_given = False
        with self.torch.no_grad():
            for column in set(range(len(HEADS))) - set(columns):
                self.policy[-1].weight[HEADS[column]] = 0.0

    def start_from(self, weights: Weights) -> None:
        """Copies the policy and its normalization."""
        self._is_given = True
        self.mean, self.scale = weights["mean"].copy(), weights["scale"].copy()
        layers = dict(enumerate(self.policy[::2]))
        self._copy(
            {f"w{n}": layer.weight for n, layer in layers.items()},
            {f"w{n}": weights[f"w{n}"].T for n in layers},
        )
        self._copy({f"b{n}": layer.bias for n, layer in layers.items()}, weights)

    def policy_weights(self) -> dict[str, FloatArray]:
        """See :class:`ActorCritic`."""
        return self._arrays(self.policy)

    def policy_inputs(self, rows: npt.NDArray[np.void], central: FloatArray) -> FloatArray:
        """See :class:`ActorCritic`."""
        del rows
        return central

    def prepare(self, seen: npt.NDArray[np.void]) -> bool:
        """Fits the normalization unless it is given, equal for a race and its mirror image."""
        if self._is_given:
            return False
        rows = np.concatenate([seen["inputs"], mirrored_inputs(seen["inputs"])])
        self.mean[:] = rows.mean(axis=0)
        self.scale[:] = 1.0 / np.maximum(rows.std(axis=0), _LEAST_SCALE)
        return True


class RacingNetwork(ActorCritic):
    """Networks on the view ``racing`` or ``contest``, with Stable-Baselines3's names in files.

    Values are normalized as in PopArt (van Hasselt et al., 2016).

    Args:
        hidden: see :class:`ActorCritic`.
        seed: see :class:`ActorCritic`.
        inputs: number of the policy's inputs, perhaps with the memory of the action filter.
        num_mates: number of other learners whose own state the value network sees too.
        hold: minimum steps of a drift, for files.
        unseen: inputs of the policy that must be 0 in training. The policy ignores them.
        memory_size: size of the memory of a recurrent policy; 0 without one.
    """

    activation = "Tanh"

    def __init__(
        self,
        hidden: Sequence[int],
        seed: int,
        inputs: int = SIZE,
        num_mates: int = 0,
        hold: int = 0,
        unseen: Sequence[int] = (),
        memory_size: int = 0,
    ) -> None:
        super().__init__(racing_shape(inputs, num_mates, memory_size), hidden, seed)
        self._hold = hold
        with self.torch.no_grad():
            self.policy[0].weight[:, list(unseen)] = 0.0
            for logit, bias in FIRST_BIASES.items():
                self.policy[-1].bias[logit] += bias

    def normalize_returns(self, returns: FloatArray) -> None:
        """See :class:`ActorCritic`; the last layer changes so that values stay the same."""
        mean, unit = self.returns
        latest = np.array([returns.mean(), max(float(returns.std()), 1e-3)], np.float32)
        self.returns = self.returns + np.float32(_RETURNS_RATE) * (latest - self.returns)
        new_mean, new_unit = map(float, self.returns)
        last = self.value[-1]
        with self.torch.no_grad():
            last.weight.mul_(float(unit) / new_unit)
            last.bias.mul_(float(unit)).add_(float(mean) - new_mean).div_(new_unit)

    def start_from(self, weights: Weights) -> None:
        """Copies the policy."""
        self._copy(self._named(), weights)

    def policy_weights(self) -> dict[str, FloatArray]:
        """See :class:`ActorCritic`."""
        tensors = {name: tensor.detach().numpy().copy() for name, tensor in self._named().items()}
        return tensors | {HOLD: np.full(1, self._hold, np.float32)}

    def _named(self) -> dict[str, Any]:
        """Returns the policy's tensors by their names in files."""
        names = [f"mlp_extractor.policy_net.{n}" for n in range(0, len(self.policy) - 1, 2)]
        return {
            f"{name}.{part}": getattr(layer, part)
            for name, layer in zip([*names, "action_net"], self.policy[::2], strict=True)
            for part in ("weight", "bias")
        }


class RecurrentNetwork(RacingNetwork):
    """A recurrent policy, and a value network that sees its memory.

    The memory (:mod:`stkzoo.agents.pretrained.recurrent`) is an additional input of both. It learns
    from sequences that begin with the memory of the rollout.

    Args:
        hidden: see :class:`RacingNetwork`.
        seed: see :class:`RacingNetwork`.
        inputs: number of the policy's inputs without the memory.
        hold: see :class:`RacingNetwork`.
        memory_size: size of the memory.
    """

    sequence = 16
    modules = (*ActorCritic.modules, "memory")

    def __init__(
        self, hidden: Sequence[int], seed: int, inputs: int, hold: int, memory_size: int
    ) -> None:
        super().__init__(hidden, seed, inputs, hold=hold, memory_size=memory_size)
        nn, rows = self.torch.nn, 3 * memory_size
        seen, kept = nn.Linear(inputs, rows), nn.Linear(memory_size, rows, bias=False)
        for layer in (seen, kept):
            nn.init.orthogonal_(layer.weight)
        nn.init.zeros_(seen.bias)
        self.memory = nn.ModuleDict({"seen": seen, "kept": kept})
        self.optimizer.param_groups[0]["params"].extend(self.memory.parameters())

    def chosen_inputs(self, inputs: Any, rows: Any, used: Any) -> Any:
        """See :class:`ActorCritic`; the memories are those of the current weights."""
        sequences = inputs[rows].reshape(-1, self.sequence, self.shape.inputs)
        return self._remembered(sequences).flatten(0, 1)[used]

    def _remembered(self, inputs: Any) -> Any:
        """Returns inputs ``(N, L, F + H)`` with the memories of the current weights."""
        torch, size = self.torch, self.shape.memory_size
        seen, before = inputs.split([self.shape.inputs - size, size], dim=2)
        has_memory = before.any(dim=2, keepdim=True)  # a new race begins without
        gates_seen, news_seen = self.memory["seen"](seen).split([2 * size, size], dim=2)
        gates_kept, news_kept = self.memory["kept"].weight.split([2 * size, size])
        memories = [before[:, 0]]
        for step in range(1, self.sequence):
            memory = memories[-1]
            gates = (1 + torch.tanh(gates_seen[:, step] + memory @ gates_kept.T)) / 2
            reset, keep = gates.chunk(2, dim=1)
            news = torch.tanh(news_seen[:, step] + (reset * memory) @ news_kept.T)
            memories.append(has_memory[:, step] * (keep * memory + (1 - keep) * news))
        return torch.cat([seen, torch.stack(memories, dim=1)], dim=2)

    def _named(self) -> dict[str, Any]:
        parts = self.memory.state_dict(keep_vars=True).items()
        return super()._named() | {f"memory.{name}": tensor for name, tensor in parts}


def _make_layers(torch: Any, sizes: Sequence[int], activation: Any, last_gain: float) -> Any:
    """Returns linear layers with orthogonal weights and no biases, as one PyTorch module.

    Args:
        torch: the module ``torch``.
        sizes: number of inputs, units of each hidden layer, number of outputs.
        activation: makes the module between two layers.
        last_gain: gain of the last layer's weights; that of the others is the root of 2.
    """
    nn = torch.nn
    parts: list[Any] = []
    for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        is_last = number == len(sizes) - 2
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, last_gain if is_last else 2**0.5)
        nn.init.zeros_(layer.bias)
        parts += [layer] if is_last else [layer, activation()]
    return nn.Sequential(*parts)


def racing_weights(init: str, hidden: Sequence[int]) -> dict[str, FloatArray]:
    """Returns the weights of a policy on the view ``racing`` and the memory of the action filter.

    If its layers take only the view as input, the memory initially has no effect.

    Args:
        init: file of the policy, or folder of an agent.
        hidden: units of the hidden layers.

    Raises:
        ConfigError: the file is unreadable, contains something else, or has other layers.
    """
    file = Path(init) / WEIGHTS if Path(init).is_dir() else Path(init)
    weights = load_weights(file)
    driver = MlpDriver(weights, f"the weights {str(file)!r}")
    if (driver.view, driver.hidden) != ("racing", tuple(hidden)):
        raise ConfigError(
            f"the weights {str(file)!r} are for the view {driver.view!r} and have hidden layers of "
            f"{driver.hidden} units, expected 'racing' and {tuple(hidden)}; give the --hidden that "
            "they were made with, or other weights"
        )
    more = SIZE + MEMORY_SIZE - driver.inputs
    return weights | {_FIRST_LAYER: np.pad(weights[_FIRST_LAYER], ((0, 0), (0, more)))}


def initial_weights(init: str, hidden: Sequence[int]) -> dict[str, FloatArray]:
    """Returns the weights of a policy over plans from a file.

    If the policy does not observe the offset that it holds, this input initially has no effect.

    Args:
        init: the file.
        hidden: units of the hidden layers.

    Raises:
        ConfigError: the file is unreadable, contains something else, or has other layers.
    """
    weights = load_weights(init)
    check_shapes(weights, init)
    layers = len(weights["b0"]), len(weights["b1"])
    if layers != tuple(hidden):
        raise ConfigError(
            f"the weights {init!r} have layers of {layers[0]} and {layers[1]} units, "
            f"expected {tuple(hidden)}; give --hidden {layers[0]} {layers[1]}"
        )
    more = INPUT_SIZE - len(weights["mean"])
    return weights | {
        "mean": np.pad(weights["mean"], (0, more)),
        "scale": np.pad(weights["scale"], (0, more), constant_values=1.0),
        "w0": np.pad(weights["w0"], ((0, more), (0, 0))),
    }
