"""A Stable-Baselines3 policy in numpy, as a file, and as an agent to race.

The policy is an ``MlpPolicy`` of tanh layers on the view ``racing``; a file of it is a
safetensors file of its state dict, and of how long it holds a drift if it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.heuristic import DriverParameters
from stkzoo.agents.heuristic.kart import DRIFT_TURN
from stkzoo.agents.pretrained.drivers import START_STEER, steer_of_turn
from stkzoo.agents.pretrained.memory import MEMORY_MIRROR, MEMORY_SIZE, DriverMemory
from stkzoo.agents.pretrained.planner import Situation
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError
from stkzoo.whole_file import whole_file
from stkzoo.wrappers.racing import BRAKE, CHOICES, MIRROR, PLACES, RESCUE, SIZE, STEERS

__all__ = [
    "INPUT_MIRROR",
    "INPUT_SIZE",
    "MlpDriver",
    "Reflexes",
    "Seat",
    "load_driver",
    "save_driver",
    "start_weights",
    "write_agent",
]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.int64]

#: How much a policy with reflexes sees: the view, and what the reflexes remember.
INPUT_SIZE = SIZE + MEMORY_SIZE
#: It times this is what would be seen if left were right.
INPUT_MIRROR = np.concatenate([MIRROR, MEMORY_MIRROR])

_LAYER = "mlp_extractor.policy_net.{}.{}"
_LAST = "action_net.{}"
_SPLITS = np.cumsum(CHOICES)[:-1].tolist()
#: The columns of choices.
_STEER, _PEDAL, _DRIFT, _NITRO, _FIRE = range(5)
#: Where the view has the speed forwards [20 m/s] and other parts, vectors by their first number.
_SPEED = PLACES["velocity"].start + 2
_SKEED, _ENERGY, _LINE, _ROOM, _HEADING = (
    PLACES[part].start
    for part in ("skeed_factor", "energy", "line_position", "line_room", "marks_heading")
)
#: A drift begins to the side to which the kart steers, if so much and at such a speed [20 m/s];
#: who steers so much to the other one lets go of it.
_DRIFT_SPEED, _OTHER_SIDE = 10.0 / 20.0, 0.3
#: Who has been so fast has left its place on the grid [20 m/s].
_MOVES = 3.0 / 20.0
#: Under this name a file says for how many steps a drift is held.
_HOLD = "drift_hold"

#: Chooses for one kart at a time: choices ``(1, 5)`` by its view ``(1, 165)``; it may remember.
Seat = Callable[[FloatArray], IntArray]

_MODULE = '''"""A driver learned by self-play with Stable-Baselines3."""

from pathlib import Path

from stkzoo.agents.training.sb3_policy import load_driver

env_name = "supertuxkart/racing-v0"
player_name = {name!r}
driver = load_driver(Path(__file__).with_name("policy.safetensors"))


def create_state():
    return driver.seat()


def get_actor(module_dir, observation_space, action_space):
    return lambda seat, observation: seat(observation[None])[0]
'''


class Reflexes:
    """What karts do without deciding, and what they remember of it, which the policy sees too.

    - **Drifts are carried through.** A drift pays after a second; who decides anew in each step
      whether to go on with it, by chance, never comes so far. And the game turns a drifting kart by
      other shares of full lock than one that does not drift, so that who tries it leaves the road.
      With reflexes a drift lasts for a while at least, and turns the kart as much as the same
      choice without one, as far as a drift can. Who steers to the other side lets go of it.
    - **Nitro is not wasted.** One burst of it works before the next.
    - **Who is stuck gets away**, as the learned drivers do.

    Args:
        karts: how many.
        hold: for how many steps a drift goes on at least; 0 leaves drifts and nitro to the choices.
        memory: theirs, if somebody else keeps it up to date and never calls :meth:`look`.
    """

    def __init__(self, karts: int, hold: int, memory: DriverMemory | None = None) -> None:
        self._hold = hold
        self._memory = memory or DriverMemory(karts, DriverParameters())
        self._has_moved = np.zeros(karts, np.bool_)
        self._views = np.zeros((karts, SIZE), np.float32)

    def look(self, views: FloatArray) -> FloatArray:
        """A step has passed.

        Args:
            views: ``(karts, 165)``.

        Returns:
            What the policy sees, ``(karts, 177)``: the views, and what is remembered.
        """
        self._memory.look(20.0 * views[:, _SPEED], views[:, _SKEED])
        aside = np.hypot(views[:, _LINE], views[:, _LINE + 2]) - views[:, _ROOM]
        self._memory.look_around(10.0 * aside)
        self._has_moved |= np.abs(views[:, _SPEED]) > _MOVES
        self._memory.forget(np.flatnonzero(~self._has_moved))  # on the grid all stand still
        return self.see(views)

    def see(self, views: FloatArray) -> FloatArray:
        """What the policy sees when no step has passed."""
        self._views = views
        return np.concatenate([views, self._memory.numbers()], axis=1)

    def apply(self, choices: npt.NDArray[Any]) -> IntArray:
        """What is done of one step's choices ``(karts, 5)``, made by what was seen last."""
        done, now = np.array(choices, np.int64), self._memory.situation()
        backs, calls = self._memory.stuck()
        side = np.where(backs | calls, 0, self._drift_side(done, now))
        turn = STEERS[done[:, _STEER]]
        if self._hold:
            uses = (done[:, _NITRO] == 1) & self._memory.may_boost & (self._views[:, _ENERGY] > 0)
            done[:, _NITRO] = uses
            begins = (side != 0) & (now.drift_side == 0)
            turn = np.where(side == 0, turn, side * np.clip(turn * side, *DRIFT_TURN))
            steer = steer_of_turn(side, turn, begins)
            in_drift = np.abs(STEERS - steer[:, None]).argmin(axis=1)
            done[:, _STEER] = np.where(side == 0, done[:, _STEER], in_drift)
            done[:, _DRIFT] = side != 0
        is_left = self._views[:, _LINE] + self._views[:, _HEADING] > 0  # of the road, or its way
        away = np.where(is_left, 0, CHOICES[_STEER] - 1)  # backwards a kart turns the other way
        done[backs, _STEER] = away[backs]
        done[backs, _PEDAL] = BRAKE
        done[calls, _PEDAL] = RESCUE
        nitro, fire = done[:, _NITRO] == 1, done[:, _FIRE] == 1
        self._memory.act(side.astype(np.intp), turn.astype(np.float32), nitro, fire)
        return done

    def forget(self, karts: slice) -> None:
        """Begins some karts anew."""
        self._memory.forget(np.arange(len(self._has_moved))[karts])
        self._has_moved[karts] = False

    def _drift_side(self, chosen: IntArray, now: Situation) -> IntArray:
        """To which side karts drift now: 1 to the right, -1 to the left, 0 for not at all."""
        turn, is_asked = STEERS[chosen[:, _STEER]], chosen[:, _DRIFT] == 1
        begins = is_asked & (np.abs(turn) >= START_STEER) & now.may_hop
        begins &= self._views[:, _SPEED] > _DRIFT_SPEED
        goes_on = is_asked | (now.drift_steps < self._hold)
        goes_on &= turn * now.drift_side > -_OTHER_SIDE
        kept = np.where(goes_on, now.drift_side, 0)
        return np.where(now.drift_side == 0, np.where(begins, np.sign(turn), 0), kept)


class MlpDriver:
    """The policy's part of a state dict, for any number of karts at once.

    Args:
        weights: a state dict, its arrays in numpy; what is not the policy's is left alone.
        name: what errors call it.

    Attributes:
        hold: for how many steps it holds a drift.
        inputs: how many numbers it sees: the view, and mostly what the reflexes remember.

    Raises:
        ConfigError: they are not of an ``MlpPolicy`` on the view ``racing``.
    """

    def __init__(self, weights: Mapping[str, FloatArray], name: str = "the weights") -> None:
        self.hold = int(np.asarray(weights.get(_HOLD, np.zeros(1))).sum())
        self._layers: list[tuple[FloatArray, FloatArray]] = []
        number = 0
        while _LAYER.format(number, "weight") in weights:
            self._layers.append(_layer(weights, _LAYER, number))
            number += 2  # every other one is the tanh
        if _LAST.format("weight") in weights:
            self._layers.append(_layer(weights, "action_net.{1}", 0))
        found = [matrix.shape for matrix, _ in self._layers]
        self.inputs = SIZE if found and found[0][-1] == SIZE else INPUT_SIZE
        sizes = [self.inputs, *(len(bias) for _, bias in self._layers)]
        wanted = list(zip(sizes[1:], sizes, strict=False))
        arrays = [array for layer in self._layers for array in layer]
        if (
            len(found) < 2
            or found != wanted
            or sizes[-1] != sum(CHOICES)
            or not all(np.isfinite(array).all() for array in arrays)
        ):
            raise ConfigError(
                f"{name} have layers of the shapes {found}, expected finite ones of a "
                f"Stable-Baselines3 MlpPolicy from the {SIZE} numbers of the view 'racing', or "
                f"{INPUT_SIZE} with what reflexes remember, to its {sum(CHOICES)} choices "
                "(mlp_extractor.policy_net.*, action_net.*)"
            )

    def logits(self, observations: FloatArray) -> FloatArray:
        """Those of all choices, ``(A, 31)``, of what karts see, ``(A, 177)``."""
        x = np.asarray(observations[:, : self.inputs], np.float32)
        *hidden, (matrix, bias) = self._layers
        for weights, offset in hidden:
            x = np.tanh(x @ weights.T + offset)
        logits: FloatArray = x @ matrix.T + bias
        return logits

    def best(self, observations: FloatArray) -> IntArray:
        """The likeliest choices, ``(A, 5)``."""
        parts = np.split(self.logits(observations), _SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)

    def seat(self) -> Seat:
        """Drives one kart through one race by the likeliest choices."""
        reflexes = Reflexes(1, self.hold)
        return lambda view: reflexes.apply(self.best(reflexes.look(view)))

    def sample(self, observations: FloatArray, random: np.random.Generator) -> IntArray:
        """Choices drawn by their probabilities, ``(A, 5)``."""
        logits = self.logits(observations)
        noisy = logits + random.gumbel(size=logits.shape).astype(np.float32)
        parts = np.split(noisy, _SPLITS, axis=1)
        return np.stack([part.argmax(axis=1) for part in parts], axis=1)


def _layer(
    weights: Mapping[str, FloatArray], pattern: str, number: int
) -> tuple[FloatArray, FloatArray]:
    names = [pattern.format(number, part) for part in ("weight", "bias")]
    matrix, bias = (np.asarray(weights.get(name, np.zeros((0, 0))), np.float32) for name in names)
    return matrix, bias.reshape(-1)


def load_driver(path: str | Path) -> MlpDriver:
    """Reads a policy's file.

    Raises:
        ConfigError: it cannot be read or holds something else.
    """
    return MlpDriver(load_weights(path), f"the weights {str(path)!r}")


def save_driver(path: str | Path, policy: Any, hold: int = 0) -> None:
    """Writes a Stable-Baselines3 policy to a file, whole or not at all.

    Args:
        path: of the file.
        policy: its state dict is kept.
        hold: for how many steps it holds a drift.
    """
    state = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    save_weights(path, state | ({_HOLD: np.array([hold], np.float32)} if hold else {}))


def start_weights(path: str | Path, policy: Any) -> dict[str, FloatArray]:
    """A state dict for a policy from a file, which may lack the value's part.

    If its layers see the view alone, what reflexes remember has no effect on them at first.

    Args:
        path: of the file; ``imitate`` and ``sb3_selfplay`` write such.
        policy: the Stable-Baselines3 policy that shall start from it.

    Raises:
        ConfigError: it cannot be read, or is of another policy.
    """
    weights = load_weights(path)
    MlpDriver(weights, f"the weights {str(path)!r}")
    weights = {name: array for name, array in weights.items() if name != _HOLD}
    own = {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}
    for name, array in weights.items():
        more = own[name].shape[-1] - array.shape[-1] if name in own and array.ndim == 2 else 0
        if array.shape[-1] == SIZE and more == MEMORY_SIZE:
            weights[name] = np.pad(array, ((0, 0), (0, more)))
    others = [n for n, array in weights.items() if n not in own or own[n].shape != array.shape]
    if others:
        raise ConfigError(
            f"the weights {str(path)!r} are of another network: {', '.join(others)} have no place "
            "in this one; give the --hidden that they were made with"
        )
    return {**own, **weights}


def write_agent(folder: str | Path, policy: Any, name: str, hold: int = 0) -> Path:
    """Makes an agent of a policy: a folder that ``stkzoo race`` takes.

    Args:
        folder: which is made.
        policy: of Stable-Baselines3.
        name: of the agent.
        hold: for how many steps it holds a drift.

    Returns:
        The folder.
    """
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    save_driver(path / "policy.safetensors", policy, hold)
    with whole_file(path / "pystk_actor.py") as part:
        part.write_text(_MODULE.format(name=name))
    return path
