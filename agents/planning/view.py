"""The plans as a view: what a policy over plans sees and chooses, for users' own learners.

An observation has ``inputs``, the numbers that a policy's network sees, and ``prior``, logits that
follow from the worth of the plans. An action is a choice among the plans; see :mod:`.driver`.

:class:`PlanChoices` wraps one agent, so it is a view of every environment. It runs agent by agent.
:class:`PlanVectorEnv` gives the same values and handles all karts of all races in one call.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from stkzoo import Phase, RaceVectorEnv
from stkzoo._checks import shortened
from stkzoo.errors import ConfigError
from stkzoo.mdp import action_of, as_actions
from stkzoo.views import View
from stkzoo.wrappers import CompiledWrapper
from stkzoo.wrappers.racing import (
    ABSENT,
    OWN_SIZE,
    Surroundings,
    road_observer,
    surroundings_of,
)

from . import BoolArray, FloatArray, IntArray
from .driver import (
    ALL_LOOKS,
    CHOICES,
    INPUT_SIZE,
    PlanDriver,
    mirrored_choices,
    mirrored_inputs,
    mirrored_prior,
)
from .memory import LINE_MARKS
from .mirrored import MirroredRaces
from .parameters import DriverParameters

if TYPE_CHECKING:
    from stkzoo.views import ViewPlan

#: Numbers of karts and items that a kart observes: the first ones, if there are more.
_KARTS, _ITEMS = 24, 64
_AROUND = ("own", "road", "karts", "items", "item_types")
_FULL_THROTTLE = np.eye(1, 7, dtype=np.float32)

OBSERVATION_SPACE = spaces.Dict(
    {
        "inputs": spaces.Box(-np.inf, np.inf, (INPUT_SIZE,), np.float32),
        "prior": spaces.Box(-np.inf, np.inf, (sum(CHOICES),), np.float32),
    }
)


class PlanView:
    """The observations and actions of A karts, with the memory of their drivers.

    Args:
        count: number of karts, A.
        parameters: parameters of the plans.

    Attributes:
        driver: the plans, and the memory of the drivers.
    """

    def __init__(self, count: int, parameters: DriverParameters | None = None) -> None:
        self.driver = PlanDriver(count, parameters)
        self._is_mirrored = np.zeros(count, np.bool_)
        self._waits = np.zeros(count, np.bool_)  # karts before GO

    def begin(self, rows: IntArray, is_mirrored: BoolArray | bool = False) -> None:
        """Begins the races of some karts.

        Args:
            rows: indices of the karts.
            is_mirrored: whether they observe and act with left and right swapped.
        """
        self.driver.memory.forget(rows)
        self._is_mirrored[rows], self._waits[rows] = is_mirrored, False

    def observe(self, seen: Mapping[str, Any], *, advances: bool = True) -> dict[str, FloatArray]:
        """Returns the karts' observations, with one row per kart.

        Args:
            seen: observations of :class:`PlanSurroundings`, with one row per kart.
            advances: whether a step has passed since the last call.
        """
        if self._waits.any():  # nothing before GO matters
            self.driver.memory.forget(np.flatnonzero(self._waits))
        self._waits = np.asarray(seen["phase"]) < Phase.GO_PHASE
        policy_input = (self.driver.look if advances else self.driver.view)(around_of(seen))
        inputs, prior = policy_input.inputs, policy_input.prior
        if self._is_mirrored.any():
            rows = self._is_mirrored[:, None]
            inputs = np.where(rows, mirrored_inputs(inputs), inputs)
            prior = np.where(rows, mirrored_prior(prior), prior)
        return {"inputs": inputs, "prior": prior}

    def drive(self, choices: npt.NDArray[Any]) -> tuple[FloatArray, BoolArray]:
        """Returns the controls for choices ``(A, 4)`` in the latest observations.

        Returns:
            See :meth:`.driver.PlanDriver.act`. Before GO, karts wait at full throttle.
        """
        chosen = np.where(self._is_mirrored[:, None], mirrored_choices(choices), choices)
        controls, applies = self.driver.act(chosen)
        controls[self._waits] = _FULL_THROTTLE
        return controls, applies & ~self._waits


# ---------------------------------------------------------------------- one agent


class PlanSurroundings(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Observes what the plans need: own state, road, karts and items as arrays of fixed sizes.

    The nearest 24 karts and 64 items are observed; positions of missing karts are not finite, and
    missing items have the type -1.

    Args:
        env: an environment in the view ``full`` or ``ground``. In ``ground``, the observation
            includes the racing line.

    Raises:
        ConfigError: the environment is in another view.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict) or "paths_start" not in space.spaces:
            raise ConfigError(f"plans need the view 'full' or 'ground', found {shortened(space)}")
        self._sees_line = "ground_line" in space.spaces
        self.observation_space = _surroundings_space(self._sees_line)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if plan.sizes or plan.is_polar or plan.is_flat or plan.observer or plan.has_action:
            return False
        plan.observer = _SurroundingsObserver(self._sees_line)
        return True

    def observation(self, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the kart's own state and surroundings."""
        around = surroundings_of(observation, ALL_LOOKS)
        return {key: array[0] for key, array in _row(around, observation["phase"]).items()}


class _SurroundingsObserver:
    """Makes the observations of :class:`PlanSurroundings` directly from the game's records."""

    def __init__(self, sees_line: bool) -> None:
        self._sees_line = sees_line

    def observe_into(self, source: Any, karts: IntArray, rows: IntArray, batch: Any) -> None:
        """See :class:`~stkzoo.views.plan.RowObserver`."""
        snapshot, observer = source.snapshot, road_observer(source.track_map)
        is_block = rows[-1] - rows[0] == len(rows) - 1
        if is_block and len(snapshot.karts) <= _KARTS and len(snapshot.items) <= _ITEMS:
            block = slice(int(rows[0]), int(rows[-1]) + 1)
            arrays = tuple(batch[key][block] for key in _AROUND)
            observer.surroundings(snapshot, karts, ALL_LOOKS, arrays)
            batch["phase"][block] = snapshot.phase
        else:
            around = observer.surroundings(snapshot, karts, ALL_LOOKS)
            for key, array in _row(around, np.full(len(karts), snapshot.phase)).items():
                batch[key][rows] = array
        if self._sees_line:
            ahead = source.ground_ahead(karts)
            line = ahead["ground_line"], ahead["ground_room"]
            batch["line"][rows] = np.concatenate(line, axis=-1)


def _row(around: Surroundings, phase: Any) -> dict[str, Any]:
    """Returns observations of A karts with arrays of the sizes in their space."""
    karts, items = _nearest(around.karts, _KARTS), _nearest(around.items, _ITEMS)
    seen = {
        "own": around.ego,
        "phase": np.reshape(phase, len(around.ego)),
        "road": around.road,
        "karts": _fitted(around.karts, karts, _KARTS, np.inf),
        "items": _fitted(around.items, items, _ITEMS, 0.0),
        "item_types": _fitted(around.item_types, items, _ITEMS, ABSENT),
    }
    return seen if around.line is None else {**seen, "line": around.line}


def _nearest(points: FloatArray, most: int) -> IntArray | None:
    """Returns the indices of the nearest points in order, ``(A, most)``; ``None`` for all."""
    if points.shape[1] <= most:
        return None
    distances = (points**2).sum(axis=2)
    return np.sort(np.argpartition(distances, most, axis=1)[:, :most], axis=1)


def _fitted(
    array: npt.NDArray[Any], chosen: IntArray | None, size: int, blank: float
) -> npt.NDArray[Any]:
    """Returns the chosen entries of an array ``(A, N, ...)``, or all, padded to ``size``."""
    if chosen is not None:
        return array[np.arange(len(array))[:, None], chosen]
    fitted = np.full((len(array), size, *array.shape[2:]), blank, array.dtype)
    fitted[:, : array.shape[1]] = array
    return fitted


def _surroundings_space(sees_line: bool) -> spaces.Dict:
    def numbers(*shape: int) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    def kinds(*shape: int) -> spaces.Box:
        return spaces.Box(ABSENT, np.iinfo(np.int32).max, shape, np.int64)

    parts: dict[str, spaces.Space[Any]]
    parts = {"own": numbers(OWN_SIZE), "phase": kinds(), "road": numbers(len(ALL_LOOKS), 4)}
    parts |= {"karts": numbers(_KARTS, 3), "items": numbers(_ITEMS, 3), "item_types": kinds(_ITEMS)}
    return spaces.Dict(parts | ({"line": numbers(len(LINE_MARKS), 5)} if sees_line else {}))


def surroundings_view(sees_line: bool) -> View:
    """Returns the view of :class:`PlanSurroundings`, with the racing line if plans need it."""
    needs = frozenset({"ground"} if sees_line else ())
    return View("surroundings", "What plans need.", (PlanSurroundings,), needs)


def around_of(seen: Mapping[str, Any]) -> Surroundings:
    """Returns the surroundings in observations of :class:`PlanSurroundings`, in rows."""
    ego, road, karts, items, item_types = (seen[key] for key in _AROUND)
    return Surroundings(ego, road, karts, items, item_types, seen.get("line"))


class PlanChoices(gym.Wrapper[Any, Any, Any, Any]):
    """Lets one agent choose among its plans.

    Observations are ``{"inputs": (INPUT_SIZE,), "prior": (15,)}`` float32. Actions are
    ``MultiDiscrete`` with the choices of :data:`.driver.CHOICE_NAMES`. Before GO, they are ignored.

    Args:
        env: an environment in the view ``full``, or ``ground`` for plans on the racing line.
        parameters: parameters of the plans.
        mirror_share: probability with which the agent observes and acts with left and right swapped
            in an episode.

    Raises:
        ConfigError: the environment is in another view.

    Example:
        >>> import stkzoo
        >>> from stkzoo.agents.planning.view import PlanChoices
        >>> env = stkzoo.race_v0.parallel_env(num_kart=2, track="lighthouse", view=PlanChoices)
        >>> observations, infos = env.reset(seed=1)
        >>> observations["kart_0"]["prior"].shape, env.action_space("kart_0")
        ((15,), MultiDiscrete([4 7 2 2]))
        >>> env.close()
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        parameters: DriverParameters | None = None,
        mirror_share: float = 0.0,
    ) -> None:
        self._surroundings = PlanSurroundings(env)
        super().__init__(env)
        self._view, self._mirror_share = PlanView(1, parameters), mirror_share
        self.observation_space = OBSERVATION_SPACE
        self.action_space = spaces.MultiDiscrete(list(CHOICES))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, FloatArray], dict[str, Any]]:
        """Begins an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        is_mirrored = bool(self.np_random.random() < self._mirror_share)
        self._view.begin(np.zeros(1, np.intp), is_mirrored)
        return self._observed(observation, advances=False), info

    def step(
        self, action: npt.NDArray[Any]
    ) -> tuple[dict[str, FloatArray], Any, bool, bool, dict[str, Any]]:
        """Drives by choices ``(4,)``."""
        controls, _ = self._view.drive(np.reshape(action, (1, len(CHOICES))))
        seen, reward, is_finished, is_cut, info = self.env.step(action_of(controls[0]))
        return self._observed(seen, advances=True), reward, is_finished, is_cut, info

    def _observed(self, observation: Mapping[str, Any], *, advances: bool) -> dict[str, FloatArray]:
        seen = self._surroundings.observation(observation)
        batch = {key: np.asarray(value)[None] for key, value in seen.items()}
        return {key: rows[0] for key, rows in self._view.observe(batch, advances=advances).items()}


# ---------------------------------------------------------------------- all karts of many races


class PlanVectorEnv(MirroredRaces):
    """Races in which every agent chooses among its plans; see :class:`~stkzoo.RaceVectorEnv`.

    Observations and actions are those of :class:`PlanChoices`, one row per slot. ``infos`` has an
    additional ``applies``, ``(num_envs,)`` bool: whether the choices of the step applied. They do
    not before GO, and when a stuck kart frees itself.

    Args:
        num_races: number of races.
        parameters: parameters of the plans.
        mirror_share: share of the slots, drawn for each race, that observe and act with left and
            right swapped.
        **options: other arguments of :class:`~stkzoo.RaceVectorEnv` except ``view``.

    Attributes:
        races: the races.
        view: plans and memory of all slots.

    Raises:
        ConfigError: an option is invalid.
    """

    view: PlanView

    def __init__(
        self,
        num_races: int = 1,
        *,
        parameters: DriverParameters | None = None,
        mirror_share: float = 0.0,
        **options: Any,
    ) -> None:
        view = surroundings_view((parameters or DriverParameters()).racing_line)
        races = RaceVectorEnv(num_races, view=view, **options)
        super().__init__(races, PlanView(races.num_envs, parameters), mirror_share)
        self.single_observation_space = OBSERVATION_SPACE
        self.single_action_space = spaces.MultiDiscrete(list(CHOICES))
        self.observation_space = batch_space(OBSERVATION_SPACE, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step of all races with choices ``(num_envs, 4)``."""
        controls, applies = self.view.drive(actions)
        self.send_controls(controls)
        self._applies = applies

    def send_controls(self, controls: FloatArray) -> None:
        """Starts a step with controls ``(num_envs, 7)`` that do not come from choices."""
        self.races.step_async(as_actions(controls))
        self._applies = np.zeros(self.num_envs, np.bool_)

    def step_wait(self) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Waits for the step and returns its result; see :meth:`step`."""
        *result, infos = super().step_wait()
        infos["applies"], infos["_applies"] = self._applies, np.ones(self.num_envs, np.bool_)
        return (*result, infos)
