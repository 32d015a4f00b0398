"""Camera images in observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_name, check_whole
from stkzoo.errors import ConfigError
from stkzoo.views.bases import RecordedWrapper

_SMALLEST, _LARGEST = 32, 4096


@dataclass(frozen=True, slots=True)
class CameraKind:
    """Kind of a camera; cameras of one kind are rendered together.

    Attributes:
        size: width and height [pixels].
        depth: whether to return depth, too.
        backend: renderer: ``"engine"``, ``"map"`` or ``"auto"``.
    """

    size: tuple[int, int]
    depth: bool = False
    backend: str = "auto"


@dataclass(frozen=True, slots=True)
class Shot:
    """Image of a camera at one moment.

    Attributes:
        image: ``(H, W, 3)`` uint8.
        depth: ``(H, W, 1)`` float32 if requested, 0 at the camera and 1 at the horizon.
    """

    image: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32] | None = None


class Camera(Protocol):
    """One agent's camera; environments provide it as their attribute ``camera``."""

    def open(self, camera_kind: CameraKind) -> None:
        """Announces the kind of images that :meth:`look` will request."""

    def look(self, camera_kind: CameraKind) -> Shot:
        """Returns the current image."""


class CameraObservations(gym.ObservationWrapper[Any, Any, Any], RecordedWrapper):
    """Adds the image of the kart's camera to its observation.

    The observation gets an entry ``image``, ``(height, width, 3)`` uint8. With ``depth``, it also
    gets ``depth``, ``(height, width, 1)`` float32: the game's depth buffer, 0 at the camera and 1
    at the horizon. An observation that is not a dict becomes the entry ``observation``.

    Use the wrapper around a Gymnasium id with one kart, or in a view of the parallel environment;
    there, one rendering serves all agents with the same kind of camera. Put it outside wrappers
    that flatten. A separate process renders the images and does not affect the race
    (``docs/how-to/rendering.md``); each environment has its own.

    Args:
        env: the environment of one kart.
        size: width and height [pixels].
        depth: whether to add the depth; not available on the map.
        every: number of steps per image; the last image is repeated in between.
        backend: renderer: ``"engine"``, the game; ``"map"``, a top-down map that follows the kart;
            ``"auto"``, the game if it can render, otherwise the map.

    Raises:
        ConfigError: an argument is invalid, the environment has no camera, or more than 8 agents
            have one.

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
        self._camera_kind = _kind(size, depth, backend)
        self._every = check_whole("every", every, 1)
        self._age = 0
        self._shot: Shot | None = None
        self.observation_space = _space(env.observation_space, self._camera_kind)
        self._camera().open(self._camera_kind)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Resets the environment and takes the first image."""
        self._shot = None
        return super().reset(seed=seed, options=options)

    def observation(self, observation: Any) -> dict[str, Any]:
        """Returns the observation with the image."""
        if self._shot is None or self._age >= self._every:
            self._shot, self._age = self._camera().look(self._camera_kind), 0
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
                f"{type(self.unwrapped).__name__} has no camera; use CameraObservations around a "
                "supertuxkart id with one agent, or in a view of stkzoo.race_v0"
            )
        return camera


def checked_size(size: Sequence[int], name: str = "size") -> tuple[int, int]:
    """Returns width and height of an image as Python integers [pixels].

    Args:
        size: the size to check.
        name: name of the size in the message.

    Raises:
        ConfigError: the size is invalid.
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
    from stkzoo.render.renderer import BACKENDS  # `import stkzoo` loads no renderer

    check_name("backend", backend, BACKENDS)
    if depth and backend == "map":
        raise ConfigError('the map has no depth; leave out depth, or backend="map"')
    return CameraKind(checked_size(size), bool(depth), "engine" if depth else backend)


def _space(inner: spaces.Space[Any], camera_kind: CameraKind) -> spaces.Dict:
    parts = dict(inner.spaces) if isinstance(inner, spaces.Dict) else {"observation": inner}
    taken = {"image", "depth"} & set(parts)
    if taken:
        raise ConfigError(
            f"observations already have {' and '.join(sorted(taken))}; use CameraObservations once"
        )
    width, height = camera_kind.size
    parts["image"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
    if camera_kind.depth:
        parts["depth"] = spaces.Box(0.0, 1.0, (height, width, 1), np.float32)
    return spaces.Dict(parts)
