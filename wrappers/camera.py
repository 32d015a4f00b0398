"""What a kart's camera sees, beside what the kart knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import ConfigError, check_whole, unknown_name
from stkzoo.views.bases import RecordedWrapper

BACKENDS = ("auto", "engine", "map")
_SMALLEST, _LARGEST = 32, 4096


@dataclass(frozen=True, slots=True)
class CameraKind:
    """What pictures a camera takes; cameras of one kind are drawn together.

    Attributes:
        size: width and height [pixels].
        depth: whether it measures distances too.
        backend: what draws: ``"engine"``, ``"map"`` or ``"auto"``.
    """

    size: tuple[int, int]
    depth: bool = False
    backend: str = "auto"


@dataclass(frozen=True, slots=True)
class Shot:
    """What a camera saw at one moment.

    Attributes:
        image: ``(H, W, 3)`` uint8.
        depth: ``(H, W, 1)`` float32, if it was asked for: 0 is at the camera and 1 at the
            horizon.
    """

    image: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32] | None = None


class Camera(Protocol):
    """One agent's camera, as an environment offers it under the name ``camera``."""

    def open(self, kind: CameraKind) -> None:
        """Says what pictures will be asked for."""

    def look(self, kind: CameraKind) -> Shot:
        """What it sees now."""


class CameraObservations(gym.ObservationWrapper[Any, Any, Any], RecordedWrapper):
    """Adds the picture of the kart's camera to its observation.

    The observation gets an entry ``image``, ``(height, width, 3)`` uint8, and with ``depth``
    another, ``depth``, ``(height, width, 1)`` float32: the game's depth buffer, 0 at the camera
    and 1 at the horizon. An observation that is no dict becomes the entry ``observation``.

    It goes around a Gymnasium id of one kart, or into a view of the parallel environment;
    there one drawing serves all agents whose cameras are of one size and kind. Use it outside
    of the wrappers that flatten. Pictures come from a process beside the race and never change
    it (``docs/how-to/rendering.md``); each environment has its own.

    Args:
        env: the environment of one kart.
        size: width and height [pixels].
        depth: adds the depth; the map has none.
        every: so many steps a new picture; between them the last one stays.
        backend: what draws: ``"engine"``, the game; ``"map"``, the race from above, following
            the kart; ``"auto"``, the game where it can, else the map.

    Raises:
        ConfigError: an argument is invalid, the environment has no camera, or more than 8
            agents have one.

    Example:
        >>> import gymnasium as gym
        >>> import stkzoo
        >>> from stkzoo.wrappers import CameraObservations
        >>> env = gym.make("supertuxkart/flattened_discrete-v0", track="lighthouse")
        >>> env = CameraObservations(env, size=(96, 64), backend="map")
        >>> observation, _ = env.reset(seed=1)
        >>> observation["image"].shape
        (64, 96, 3)
        >>> env.close()
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        *,
        size: Sequence[int] = (84, 84),
        depth: bool = False,
        every: int = 1,
        backend: str = "auto",
    ) -> None:
        super().__init__(env)
        self._kind = _kind(size, depth, backend)
        self._every = check_whole("every", every, 1)
        self._age = 0
        self._shot: Shot | None = None
        self.observation_space = _space(env.observation_space, self._kind)
        self._camera().open(self._kind)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Resets the environment and takes the first picture."""
        self._shot = None
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> dict[str, Any]:
        """The observation with the picture."""
        if self._shot is None or self._age >= self._every:
            self._shot, self._age = self._camera().look(self._kind), 0
        self._age += 1
        seen = dict(observation) if isinstance(observation, dict) else {"observation": observation}
        seen["image"] = self._shot.image.copy()
        if self._shot.depth is not None:
            seen["depth"] = self._shot.depth.copy()
        return seen

    def _camera(self) -> Camera:
        camera: Camera | None = getattr(self.unwrapped, "camera", None)
        if camera is None:
            raise ConfigError(
                f"{type(self.unwrapped).__name__} has no camera; CameraObservations goes around a "
                "supertuxkart id of one kart, or into a view of stkzoo.race_v0"
            )
        return camera


def checked_size(size: Sequence[int], name: str = "size") -> tuple[int, int]:
    """Width and height of a picture as Python's own numbers [pixels].

    Args:
        size: what was asked for.
        name: what the message calls it.

    Raises:
        ConfigError: it is invalid.
    """
    try:
        width, height = (int(side) for side in size if int(side) == side)
    except (TypeError, ValueError):
        width = height = 0
    if not all(_SMALLEST <= side <= _LARGEST for side in (width, height)):
        raise ConfigError(
            f"{name} is {size!r}, expected (width, height) from {_SMALLEST} to {_LARGEST} pixels "
            "each, such as (640, 480)"
        )
    return width, height


def _kind(size: Sequence[int], depth: bool, backend: str) -> CameraKind:
    if backend not in BACKENDS:
        raise unknown_name("backend", backend, BACKENDS)
    if depth and backend == "map":
        raise ConfigError('the map has no depth; leave out depth, or backend="map"')
    return CameraKind(checked_size(size), bool(depth), "engine" if depth else backend)


def _space(inner: spaces.Space[Any], kind: CameraKind) -> spaces.Dict:
    parts = dict(inner.spaces) if isinstance(inner, spaces.Dict) else {"observation": inner}
    taken = {"image", "depth"} & set(parts)
    if taken:
        raise ConfigError(
            f"observations have {' and '.join(sorted(taken))} already; use one CameraObservations"
        )
    width, height = kind.size
    parts["image"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
    if kind.depth:
        parts["depth"] = spaces.Box(0.0, 1.0, (height, width, 1), np.float32)
    return spaces.Dict(parts)
