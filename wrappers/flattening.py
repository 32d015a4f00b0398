"""Wrappers that flatten observations and actions to vectors."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_flag, shortened
from stkzoo._left_out import LeftOutNames
from stkzoo.errors import ConfigError
from stkzoo.views.bases import ActionFormWrapper, CompiledWrapper, dict_space

if TYPE_CHECKING:
    from stkzoo.views.plan import ViewPlan


class SpaceFlattener(LeftOutNames):
    """Flattens the entries of a ``Dict`` space, in the order of their keys.

    ``Box`` entries go to ``"continuous"``, ``Discrete`` and ``MultiDiscrete`` entries to
    ``"discrete"``. If all entries are of one sort, the flattened space is a plain ``Box`` or
    ``MultiDiscrete``. ``Text`` entries and the game AI's ``action`` are dropped.

    Attributes:
        space: the flattened space.
        vectors: spaces of its vectors, by name.
        parts: entries of each vector by key, sorted.
        continuous_keys: keys of the ``Box`` entries, sorted.
        discrete_keys: keys of the other entries, sorted.
        only_continuous: whether ``space`` is a plain ``Box``.
        only_discrete: whether ``space`` is a plain ``MultiDiscrete``.

    Args:
        space: the space to flatten.

    Raises:
        ConfigError: an entry has another kind of space, or there is no entry.
    """

    left_out: ClassVar = dict.fromkeys(
        ("indices", "shapes", "passthrough_keys", "passthrough_spaces"), "use parts and unflatten"
    )

    def __init__(self, space: spaces.Dict) -> None:
        boxes: dict[str, spaces.Space[Any]] = {}
        choices: dict[str, spaces.Space[Any]] = {}
        for key, part in sorted(space.spaces.items()):
            if key == "action" or isinstance(part, spaces.Text):
                continue
            if isinstance(part, spaces.Box):
                boxes[key] = part
            elif isinstance(part, (spaces.Discrete, spaces.MultiDiscrete)):
                choices[key] = part
            else:
                raise ConfigError(_cannot_flatten(key, part))
        if not boxes and not choices:
            raise ConfigError(
                f"nothing to flatten; expected numbers or choices, found {shortened(space)}"
            )
        self.continuous_keys, self.discrete_keys = list(boxes), list(choices)
        self.only_continuous, self.only_discrete = not choices, not boxes
        self.parts: dict[str, dict[str, spaces.Space[Any]]] = {}
        self.vectors: dict[str, spaces.Space[Any]] = {}
        if boxes:
            self.parts["continuous"], self.vectors["continuous"] = boxes, _joined_boxes(boxes)
        if choices:
            self.parts["discrete"], self.vectors["discrete"] = choices, _joined_choices(choices)
        self.space = _sole(self.vectors) if len(self.vectors) == 1 else spaces.Dict(self.vectors)

    def flatten_parts(self, value: Mapping[str, Any]) -> dict[str, npt.NDArray[Any]]:
        """Returns the vectors of a value, ``(n,)`` float32 and ``(m,)`` int64."""
        return {
            name: _joined(value, parts, self.vectors[name].dtype)
            for name, parts in self.parts.items()
        }

    def discrete(self, value: Mapping[str, Any]) -> npt.NDArray[np.int64]:
        """Returns the discrete vector of a value, ``(m,)`` int64."""
        return self.flatten_parts(value)["discrete"]

    def flatten(self, value: Mapping[str, Any]) -> Any:
        """Converts a value of the original space to one of ``self.space``."""
        vectors = self.flatten_parts(value)
        return _sole(vectors) if len(vectors) == 1 else vectors

    def unflatten(self, flat: Any) -> dict[str, Any]:
        """Converts a value of ``self.space`` to the original space, without dropped entries."""
        value: dict[str, Any] = {}
        for name, parts in self.parts.items():
            vector = flat if len(self.parts) == 1 else flat[name]
            value.update(_entries(np.asarray(vector), parts))
        return value


class FlattenerWrapper(ActionFormWrapper, CompiledWrapper):
    """Joins all continuous entries into one vector and all discrete entries into another.

    The observation becomes ``{"continuous": (n,) float32, "discrete": (m,) int64}``, with entries
    in the order of their keys; the text ``kart_type`` is dropped. An action with continuous and
    discrete entries becomes a dict with the same two keys; one with only continuous entries becomes
    a ``Box``, and one with only discrete entries a ``MultiDiscrete``. If the observation includes
    the game AI's ``action``, it stays a separate entry, in the flattened action space.

    Args:
        env: an environment whose observations have a fixed size.
        flatten_observations: ``False`` flattens only the actions.

    Raises:
        ConfigError: a space is not a ``Dict``, or an entry cannot be flattened.
    """

    def __init__(self, env: gym.Env[Any, Any], flatten_observations: bool = True) -> None:
        super().__init__(env)
        self.flatten_observations = check_flag("flatten_observations", flatten_observations)
        self.action_flattener = SpaceFlattener(
            dict_space(env.action_space, "actions", "FlattenerWrapper")
        )
        self._change_action_space(self.action_flattener.space)
        if self.flatten_observations:
            self.observation_flattener = SpaceFlattener(
                dict_space(env.observation_space, "observations", "FlattenerWrapper")
            )
            self.observation_space = self.observation_flattener.space
            if self.has_action:
                parts = {"action": copy.deepcopy(self.action_space)}
                self.observation_space = spaces.Dict(parts | self.observation_flattener.vectors)

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        is_seen = not self.flatten_observations or (
            len(plan.sizes) == 3 and not (plan.is_flat or plan.extras or plan.observer)
        )
        if plan.has_action or not is_seen or "" in plan.leaves:
            return False
        if self.flatten_observations:
            flattener = self.observation_flattener
            plan.parts = dict.fromkeys(flattener.continuous_keys, "continuous")
            plan.parts |= dict.fromkeys(flattener.discrete_keys, "discrete")
        leaves = {
            name: tuple(entry for key in parts for entry in plan.leaves[key])
            for name, parts in self.action_flattener.parts.items()
        }
        plan.leaves = leaves if len(leaves) > 1 else {"": next(iter(leaves.values()))}
        return True

    def observation(self, observation: dict[str, Any]) -> Any:
        """Returns the observation as vectors, ``(n,)`` and ``(m,)``."""
        if not self.flatten_observations:
            return super().observation(dict(observation))
        if not self.has_action:
            return self.observation_flattener.flatten(observation)
        action = self.observed_action(observation["action"])
        return {"action": action, **self.observation_flattener.flatten_parts(observation)}

    def observed_action(self, action: dict[str, Any]) -> Any:
        """Returns the action as vectors."""
        return self.action_flattener.flatten(action)

    def action(self, action: Any) -> dict[str, Any]:
        """Returns the action as a dict of its entries."""
        return self.action_flattener.unflatten(action)


class JoinedObservations(gym.ObservationWrapper[Any, Any, Any], CompiledWrapper):
    """Joins the ``continuous`` and ``discrete`` vectors of a flattened view into one.

    The observation becomes ``(n + v,)`` float32: the ``n`` continuous values, followed by a one-hot
    encoding of the discrete entries, ``v`` values in total. If the view has further entries
    (``action_mask``, or the game AI's ``action``), the observation stays a dict, with the vector
    under ``observation``.

    Args:
        env: an environment in a flattened view.

    Raises:
        ConfigError: the environment's observations do not have these two vectors.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        parts = getattr(env.observation_space, "spaces", {})
        numbers, choices = parts.get("continuous"), parts.get("discrete")
        if not isinstance(numbers, spaces.Box) or not isinstance(choices, spaces.MultiDiscrete):
            raise ConfigError(
                "JoinedObservations needs a flattened view, with a Box under 'continuous' and a "
                "MultiDiscrete under 'discrete'. Put FlattenerWrapper inside it. Found "
                f"{env.observation_space!r:.200}"
            )
        sizes = np.asarray(choices.nvec, np.int64)
        self._sizes = tuple(sizes.tolist())
        self._count = int(sizes.sum())
        self._places = np.concatenate([[0], np.cumsum(sizes)[:-1]]) - choices.start
        ones = np.ones(self._count, np.float32)
        low, high = np.append(numbers.low, 0 * ones), np.append(numbers.high, ones)
        joined = spaces.Box(low, high, dtype=np.float32)
        rest = {key: part for key, part in parts.items() if key not in ("continuous", "discrete")}
        self.observation_space = (
            spaces.Dict({"observation": joined, **copy.deepcopy(rest)}) if rest else joined
        )
        self._keys = tuple(getattr(self.observation_space, "spaces", ()))

    def compile_into(self, plan: ViewPlan) -> bool:
        """See :class:`~stkzoo.views.bases.CompiledWrapper`."""
        if not plan.is_flat or "observation" in plan.parts.values():
            return False
        sizes = iter(self._sizes)
        for name, part in plan.parts.items():
            if part == "discrete":
                count = plan.sizes["items"] if name == "items_type" else 1
                plan.ones[name], *_ = (next(sizes) for _ in range(count))
            plan.parts[name] = part if part == "action_mask" else "observation"
        return True

    def observation(self, observation: Any) -> Any:
        """Returns the observation as one vector, ``(n + v,)``, with any further entries."""
        ones = np.zeros(self._count, np.float32)
        ones[np.asarray(observation["discrete"], np.int64) + self._places] = 1.0
        joined = np.concatenate([observation["continuous"], ones], dtype=np.float32)
        if not self._keys:
            return joined
        seen = {**observation, "observation": joined}
        return {key: seen[key] for key in self._keys}


def _sole(by_name: Mapping[str, Any]) -> Any:
    (value,) = by_name.values()
    return value


def _joined_boxes(parts: Mapping[str, Any]) -> spaces.Box:
    low, high = (
        np.concatenate([getattr(box, bound).ravel() for box in parts.values()]).astype(np.float32)
        for bound in ("low", "high")
    )
    return spaces.Box(low, high, dtype=np.float32)


def _joined_choices(parts: Mapping[str, Any]) -> spaces.MultiDiscrete:
    counts: list[int] = []
    starts: list[int] = []
    for part in parts.values():
        counts.extend(np.ravel(part.n if isinstance(part, spaces.Discrete) else part.nvec))
        starts.extend(np.ravel(part.start))
    return spaces.MultiDiscrete(counts, dtype=np.int64, start=starts)


def _joined(value: Mapping[str, Any], keys: Iterable[str], dtype: Any) -> npt.NDArray[Any]:
    """Joins entries to ``(n,)``; a plain number counts as one value."""
    return np.concatenate([np.ravel(np.asarray(value[key], dtype)) for key in keys])


def _entries(array: npt.NDArray[Any], parts: Mapping[str, spaces.Space[Any]]) -> dict[str, Any]:
    """Splits ``(..., n)`` into entries ``(..., *shape)``, one per part."""
    shapes = {key: part.shape or () for key, part in parts.items()}
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()]).tolist()
    if array.ndim == 0 or array.shape[-1] != ends[-1]:
        raise ValueError(
            f"got an array of shape {array.shape} for {', '.join(parts)}; "
            f"expected {ends[-1]} values on its last axis."
        )
    pieces = np.split(array, ends[:-1], axis=-1)
    return {
        key: piece.reshape((*array.shape[:-1], *shape))[()]
        for (key, shape), piece in zip(shapes.items(), pieces, strict=True)
    }


def _cannot_flatten(key: str, part: spaces.Space[Any]) -> str:
    advice = (
        "Put ConstantSizedObservations inside this wrapper."
        if isinstance(part, spaces.Sequence)
        else "Leave it out, or turn it into a Box, with a wrapper of your own."
    )
    return f"cannot flatten {key!r}, which is {part!r}. {advice}"
