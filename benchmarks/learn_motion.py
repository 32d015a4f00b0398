"""Trains the network that simulates how karts move in plans.

    python -m benchmarks.learn_motion --output motion

Karts driven by their plans, with random offsets to the steering, race each other on training
tracks. From the memory and the actions of their drivers, a small network learns how much each kart
turns in the next 0.1 s, and how its forward and sideways speeds change. Steps in which a kart
flies, crashes or is rescued are left out. Each step is also learned mirrored.

The folder contains ``motion.safetensors``, which replaces the file in ``agents/planning``. The
command also prints the errors of its forecasts of a step on the validation tracks, which are not
used for training.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.common import parser, positive
from stkzoo.agents.planning import BoolArray, FloatArray
from stkzoo.agents.planning.driver import PlanDriver, PolicyInput
from stkzoo.agents.planning.memory import PlanMemory
from stkzoo.agents.planning.motion import LAYERS, WEIGHTS, MotionState
from stkzoo.agents.planning.network import Mlp
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.view import PlanVectorEnv
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.command import ProgressBar, training_torch
from stkzoo.mdp import rotation_matrices
from stkzoo.tracks import SPLITS

#: First seed of the races; other programs use other numbers.
_FIRST_SEED = 9000
#: Number of parallel races, karts in each, and steps of a race.
_RACES, _KARTS, _STEPS = 4, 6, 450
#: Probability per step of a new steering offset, probability that it is zero, and its magnitude.
_NEW_OFFSET, _NO_OFFSET, _OFFSET = 0.1, 0.5, 0.25
#: Limits of ordinary steps: turn [rad], change of speed [m/s], distance [m], and speed [m/s].
_MOST_TURN, _MOST_GAIN, _MOST_WAY, _LEAST_SPEED = 0.4, 3.0, 6.0, 3.0
#: Units of the outputs: turn [rad], changes of speed [m/s].
_UNITS = np.array([0.05, 0.3, 0.3], np.float32)
#: Inputs whose sign changes in a mirrored race; the last input is nitro, which plans do not use.
_ODD = np.array([0, 1, 1, 1, 1, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 0], bool)
_MIRROR = np.where(_ODD, -1, 1).astype(np.float32)
_OUTPUT_MIRROR = np.array([-1, 1, -1], np.float32)
#: Error at which the loss becomes linear, in the units of the outputs.
_LINEAR_FROM = 0.3


class _Noisy(PlanDriver):
    """A policy that follows the plans with an offset to the steering of each kart."""

    offset: FloatArray = np.zeros(0, np.float32)

    def moves(self, choices: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.intp], FloatArray]:
        side, turn = super().moves(choices)
        return side, np.clip(turn + self.offset, -1, 1).astype(np.float32)


def drive(
    tracks: Sequence[str], rounds: int, rules: DriverParameters, seed: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Drives rounds of races; yields the examples of each, see :func:`_examples`.

    Args:
        tracks: tracks, drawn uniformly and in both directions.
        rounds: number of rounds.
        rules: parameters of the plans.
        seed: seed of the races and offsets.
    """
    random = np.random.default_rng(seed)
    plans, count = RacingPolicy.of_plans_alone(), _RACES * _KARTS
    races = PlanVectorEnv(
        _RACES,
        parameters=rules,
        num_kart=_KARTS,
        agents=_KARTS,
        track=tuple(tracks),
        reverse=None,
        difficulty=3,
        num_starts=_RACES,
        skip_countdown=True,
    )
    races.view.driver = driver = _Noisy(count, rules)
    with closing(races):
        for number in range(rounds):
            observations, _ = races.reset(seed=_FIRST_SEED + 1000 * seed + number)
            driver.offset = np.zeros(count, np.float32)
            rows: list[tuple[npt.NDArray[Any], ...]] = []
            is_first = np.ones(count, np.bool_)  # karts in their first race
            while is_first.any() and len(rows) < _STEPS:
                is_new = random.random(count) < _NEW_OFFSET
                drawn = random.normal(0, _OFFSET, count) * (random.random(count) > _NO_OFFSET)
                driver.offset = np.where(is_new, drawn, driver.offset).astype(np.float32)
                controls, _ = races.view.drive(plans.best(PolicyInput(**observations)))
                karts = np.concatenate([_karts_of(race) for race in races.races.races])
                rows.append((karts, controls, driver.memory.rows.copy(), is_first.copy()))
                races.send_controls(controls)
                observations, _, finished, cut, _ = races.step_wait()
                is_first &= ~(finished | cut)
            karts, controls, memory, active = map(np.array, zip(*rows, strict=True))
            yield _examples(karts, controls, memory, active)


def _karts_of(race: Any) -> npt.NDArray[np.void]:
    """Returns the records of a race's karts, in the order of its agents."""
    return np.asarray(race.snapshot.karts[list(race.race.kart_indices)])


def _examples(
    karts: npt.NDArray[np.void], controls: FloatArray, memory: FloatArray, active: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Returns inputs ``(N, 17)`` and outputs ``(N, 3)`` of steps with ordinary motion before them.

    Args:
        karts: records of the karts, ``(T, A)``.
        controls: their controls, ``(T, A, 7)``.
        memory: memory of their drivers after they have acted, ``(T, columns, A)``.
        active: ``(T, A)``, karts in their first race.
    """
    remembered = PlanMemory(*memory.swapaxes(0, 1))
    forward = rotation_matrices(karts["rotation"])[..., 2, :]
    heading = np.arctan2(forward[..., 0], forward[..., 2])
    place, velocity = karts["location"][..., ::2], karts["velocity_lc"]
    speed, slide = velocity[..., 2], velocity[..., 0]
    yaw, gain, way = (np.zeros_like(speed) for _ in range(3))
    yaw[1:] = (np.diff(heading, axis=0) + np.pi) % (2 * np.pi) - np.pi
    gain[1:], way[1:] = np.diff(speed, axis=0), np.abs(np.diff(place, axis=0)).max(axis=-1)
    before = np.zeros_like(remembered.turn)
    before[1:] = remembered.turn[:-1]
    frees_itself = (remembered.reverse_steps > 0) | (remembered.rescue_steps > 0)
    is_ordinary = active & (karts["jumping"] == 0) & ~frees_itself & (speed > _LEAST_SPEED)
    is_ordinary &= (np.abs(yaw) < _MOST_TURN) & (np.abs(gain) < _MOST_GAIN) & (way < _MOST_WAY)
    state = MotionState(
        speed=speed,
        slide=slide,
        yaw=yaw,
        turn=remembered.turn,
        turn_before=before,
        side=remembered.drift_side,
        steps=remembered.drift_steps,
        release=remembered.release_steps,
        drift_turn=remembered.drift_turn,
        boost=remembered.boost_steps,
        big_boost=remembered.big_boost_steps,
        brake=controls[..., 2],
    )
    nitro = (controls[..., 5] * (karts["energy"] > 0)).astype(np.float32)
    inputs = np.concatenate([state.inputs(), nitro[..., None]], axis=-1)
    outputs = np.stack([yaw[1:], np.diff(speed, axis=0), np.diff(slide, axis=0)], axis=-1)
    kept = is_ordinary[:-2] & is_ordinary[1:-1] & is_ordinary[2:]
    return inputs[1:-1][kept], outputs[1:][kept]


def fit(inputs: FloatArray, outputs: FloatArray, options: argparse.Namespace) -> list[FloatArray]:
    """Trains the network.

    Args:
        inputs: ``(N, 17)``.
        outputs: ``(N, 3)``.
        options: options of the command.

    Returns:
        The arrays of :data:`~stkzoo.agents.planning.motion.LAYERS`.
    """
    torch = training_torch()
    torch.manual_seed(options.seed)
    nn, (first, second) = torch.nn, options.hidden
    mean, scale = inputs.mean(axis=0), 1 / (inputs.std(axis=0) + np.float32(1e-3))
    mean[_ODD] = 0
    x = torch.from_numpy((np.concatenate([inputs, inputs * _MIRROR]) - mean) * scale)
    y = torch.from_numpy(np.concatenate([outputs, outputs * _OUTPUT_MIRROR]) / _UNITS)
    layers = nn.Linear(x.shape[1], first), nn.Linear(first, second), nn.Linear(second, 3)
    network = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])
    optimizer = torch.optim.Adam(network.parameters())
    batches = -(-len(x) // options.batch_size)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, options.learning_rate, total_steps=options.n_epochs * batches
    )
    random = np.random.default_rng(options.seed)
    with ProgressBar(options.n_epochs, unit="epochs") as bar:
        for epoch in range(options.n_epochs):
            order = torch.from_numpy(random.permutation(len(x)))
            for rows in order.split(options.batch_size):
                missed = nn.functional.smooth_l1_loss(network(x[rows]), y[rows], beta=_LINEAR_FROM)
                optimizer.zero_grad()
                missed.backward()
                optimizer.step()
                schedule.step()
            bar.report(epoch + 1, f"loss of the last batch {float(missed.detach()):.4f}")
    arrays = [parameter.detach().numpy().copy() for parameter in network.parameters()]
    arrays[0] *= scale
    arrays[1] -= arrays[0] @ mean
    arrays[0] = arrays[0][:, :-1]  # plans use no nitro
    arrays[4] *= _UNITS[:, None]
    arrays[5] *= _UNITS
    return arrays


def errors_of(layers: Sequence[FloatArray], inputs: FloatArray, outputs: FloatArray) -> FloatArray:
    """Returns the errors of a network's outputs ``(N, 3)``, in the units of the outputs."""
    pairs = zip(layers[::2], layers[1::2], strict=True)
    network = Mlp([(w.T, bias) for w, bias in pairs], False)
    return network(inputs[:, :-1]) - outputs  # plans use no nitro


def learn_motion(options: argparse.Namespace) -> None:
    """Trains the network, saves it and prints its errors."""
    training_torch()  # says what is missing before the karts drive
    options.output.mkdir(parents=True, exist_ok=True)
    rules = DriverParameters(learned_motion=options.learned_motion)
    rounds = []
    with ProgressBar(options.rounds, unit="rounds") as bar:
        for examples in drive(SPLITS["train_only"], options.rounds, rules, options.seed):
            rounds.append(examples)
            bar.report(len(rounds), f"{sum(len(inputs) for inputs, _ in rounds):,} steps")
    layers = fit(*_joined(rounds), options)
    save_weights(options.output / WEIGHTS.name, dict(zip(LAYERS, layers, strict=True)))
    unseen = drive(SPLITS["validation"], 4, rules, options.seed + 1)
    errors = errors_of(layers, *_joined(unseen))
    print("errors of a step: turn [rad], gain of forward and of sideways speed [m/s]:")
    middle, mean = np.median(np.abs(errors), axis=0), np.sqrt((errors**2).mean(axis=0))
    print(f"  median {middle.round(4)}, root mean square {mean.round(4)}")


def _joined(rounds: Iterable[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Returns the inputs and the outputs of several rounds."""
    inputs, outputs = zip(*rounds, strict=True)
    return np.concatenate(inputs), np.concatenate(outputs)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("learn_motion", __doc__)
    words.add_argument("--output", type=Path, required=True, help="folder of the network")
    words.add_argument(
        "--rounds", type=positive, default=30, help="rounds of four races of six karts each"
    )
    words.add_argument(
        "--hidden", type=positive, nargs=2, default=(24, 16), help="units of the two hidden layers"
    )
    words.add_argument("--n-epochs", type=positive, default=20, help="passes over all steps")
    words.add_argument("--batch-size", type=positive, default=1024, help="steps per gradient step")
    words.add_argument(
        "--learning-rate", type=float, default=4e-3, help="highest learning rate of Adam"
    )
    words.add_argument(
        "--learned-motion", action="store_true", help="the karts' plans use the current network"
    )
    words.add_argument("--seed", type=int, default=0, help="seed of all random numbers")
    learn_motion(words.parse_args(arguments))
    return 0


if __name__ == "__main__":
    sys.exit(main())
