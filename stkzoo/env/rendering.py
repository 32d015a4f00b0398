"""Pictures of a race: its frames and window, and the agents' cameras."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stkzoo._checks import check_name, unknown_name
from stkzoo._os import check_display, display_problem
from stkzoo.engine.render_session import has_graphics_card
from stkzoo.engine.setup import MAX_CAMERAS
from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.episode import Episode
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.names import CameraMode
from stkzoo.render.renderer import BACKENDS, RaceRenderer
from stkzoo.render.scene import Scene
from stkzoo.wrappers.camera import Camera, CameraKind, Shot, checked_size

if TYPE_CHECKING:
    from stkzoo.env.race import Race

#: The render modes; ``None`` disables rendering.
RENDER_MODES = ("human", "rgb_array")

_PRESETS = ("ld", "sd", "hd")


class Rendering:
    """Renders the races of one environment according to its render mode.

    Frames are made from snapshots, so rendering does not affect the race.

    Args:
        mode: one of :data:`RENDER_MODES`, or ``None``.
        backend: renderer: ``"auto"``, ``"engine"`` or ``"map"``.
        size: width and height of a frame [pixels].
        graphics_config: see :func:`drawing_preset`.

    Raises:
        ConfigError: an argument is invalid.
    """

    def __init__(
        self, mode: str | None, backend: str, size: Sequence[int], graphics_config: Any
    ) -> None:
        if mode is not None and not (isinstance(mode, str) and mode in RENDER_MODES):
            raise ConfigError(
                f"render_mode is {mode!r}, expected None or one of {', '.join(RENDER_MODES)}"
            )
        check_name("render_backend", backend, BACKENDS)
        if mode == "human" and backend == "map":
            raise ConfigError(
                'render_mode="human" opens the game\'s window, but render_backend is "map"; use '
                'render_mode="rgb_array" for pictures of the map, or another render_backend'
            )
        self.mode = mode
        preset = drawing_preset(mode, graphics_config)
        pixels = checked_size(size, "render_size")
        self._renderer = RaceRenderer(backend, pixels, preset, has_window=mode == "human")

    @property
    def backend(self) -> str:
        """Renderer in use; see :attr:`stkzoo.render.renderer.RaceRenderer.backend`."""
        return self._renderer.backend

    def check(self) -> None:
        """Checks that the next race can be rendered.

        Raises:
            ConfigError: there is no display for the window.
        """
        if self.mode == "human":
            check_display("render_mode is 'human'", " or render_mode=None")

    def reset(self, episode: Episode) -> None:
        """Prepares for a new episode."""
        self._renderer.begin(scene_of(episode))
        self.follow(episode)

    def follow(self, episode: Episode) -> None:
        """Updates the window, or the trails on the map, after a step."""
        if self.mode is None:
            return
        self._renderer.follow(scene_of(episode))
        self._renderer.remember(episode.snapshot)
        if self.mode == "human":
            self._renderer.show(episode.snapshot)

    def render(self, episode: Episode | None) -> Any:
        """Returns the result of the environment's ``render()``."""
        if self.mode is None:
            warnings.warn(
                'render() shows nothing without a render mode; pass render_mode="rgb_array" or '
                '"human"',
                stacklevel=3,
            )
            return None
        if self.mode == "human":
            return None
        if episode is None:
            raise ApiOrderError("render() before reset(); call reset() first")
        self._renderer.follow(scene_of(episode))
        return self._renderer.picture(episode.snapshot)

    def close(self) -> None:
        """Stops the render process, if there is one."""
        self._renderer.close()


def available_modes() -> list[str]:
    """Returns the render modes that work on this machine; ``"human"`` needs a display."""
    return [mode for mode in RENDER_MODES if mode != "human" or not display_problem()]


def scene_of(episode: Episode) -> Scene:
    """Returns the episode's race in the form that renderers use."""
    race = episode.race
    return Scene(episode.setup, episode.track_map, race.kart_types, race.kart_indices)


def drawing_preset(mode: str | None, choice: Any) -> str | dict[str, Any]:
    """Returns the graphics settings for :class:`stkzoo.engine.render_session.RenderSession`.

    Args:
        mode: the render mode.
        choice: name of a preset, a ``pystk2.GraphicsConfig``, or ``None``. ``None`` selects the
            highest quality for a window on a machine with a graphics card, otherwise the fastest
            preset.

    Raises:
        ConfigError: the choice is invalid.
    """
    if choice is None:
        return "hd" if mode == "human" and has_graphics_card() else "ld"
    if isinstance(choice, str) and choice in _PRESETS:
        return choice
    if not hasattr(choice, "screen_width"):
        raise unknown_name("graphics_config", choice, _PRESETS)
    names = [name for name in dir(choice) if not name.startswith("_")]
    values = {name: getattr(choice, name) for name in names}
    return {name: v for name, v in values.items() if isinstance(v, (bool, int, float))}


def frame_rate(step_size: float) -> float:
    """Returns the number of frames per second of game time, one per step; an ``int`` if whole."""
    rate = 1 / step_size
    return round(rate) if abs(rate - round(rate)) < 1e-6 else rate


# ---------------------------------------------------------------------- the agents' cameras


class RaceCameras:
    """The cameras of all agents of one environment.

    Args:
        agents: ids of all agents.
        race: the race, by a weak reference; also an attribute.

    Attributes:
        by_agent: the camera of each agent.
    """

    def __init__(self, agents: Sequence[str], race: Race) -> None:
        self.race = race
        self.by_agent: dict[str, Camera] = {
            agent: _AgentCamera(self, number) for number, agent in enumerate(agents)
        }
        self._drawings: dict[CameraKind, _Drawing] = {}

    def drawing(self, camera_kind: CameraKind) -> _Drawing:
        """Returns the renderer of all cameras of one kind."""
        return self._drawings.setdefault(camera_kind, _Drawing(camera_kind))

    def close(self) -> None:
        """Stops the render processes."""
        for drawing in self._drawings.values():
            drawing.close()


class _AgentCamera:
    """The camera of one agent; implements :class:`~stkzoo.wrappers.camera.Camera`."""

    def __init__(self, cameras: RaceCameras, number: int) -> None:
        self._cameras, self._number = cameras, number

    def open(self, camera_kind: CameraKind) -> None:
        self._cameras.drawing(camera_kind).add(self._number)

    def look(self, camera_kind: CameraKind) -> Shot:
        episode = self._cameras.race.episode
        if episode is None:
            raise ApiOrderError("there is nothing to see before reset(); call reset() first")
        drawing = self._cameras.drawing(camera_kind)
        drawing.add(self._number)  # a copied wrapper opened the camera in another race
        return drawing.shots(episode)[self._number]


class _Drawing:
    """The renderer of all cameras of one kind."""

    def __init__(self, camera_kind: CameraKind) -> None:
        self.agents: set[int] = set()
        self._camera_kind = camera_kind
        self._renderer = RaceRenderer(camera_kind.backend, camera_kind.size)
        self._shown: Snapshot | None = None
        self._shots: dict[int, Shot] = {}

    def add(self, agent: int) -> None:
        """Adds a camera for an agent.

        Raises:
            ConfigError: there are too many cameras.
        """
        if agent not in self.agents:
            self.agents.add(agent)
            self._shown = None
        if len(self.agents) > MAX_CAMERAS:
            raise ConfigError(
                f"{len(self.agents)} agents have views with a camera, but the game draws at most "
                f"{MAX_CAMERAS}; give the other agents another view"
            )

    def shots(self, episode: Episode) -> dict[int, Shot]:
        """Returns the cameras' images of the current moment, by agent number."""
        if episode.snapshot is not self._shown:
            self._renderer.follow(_with_cameras(scene_of(episode), self.agents))
            karts = episode.race.kart_indices
            by_kart = self._draw(episode.snapshot)
            self._shots = {agent: by_kart[karts[agent]] for agent in self.agents}
            self._shown = episode.snapshot
        return self._shots

    def close(self) -> None:
        self._shown = None
        self._renderer.close()

    def _draw(self, snapshot: Snapshot) -> dict[int, Shot]:
        if not self._camera_kind.depth:
            images = self._renderer.pictures(snapshot)
            return {kart: Shot(image) for kart, image in images.items()}
        images, depths = self._renderer.pictures_and_depths(snapshot)
        return {kart: Shot(image, depths[kart][..., None]) for kart, image in images.items()}


def _with_cameras(scene: Scene, agents: set[int]) -> Scene:
    """Returns the scene with cameras for these agents only and without name tags."""
    karts = {scene.kart_indices[agent] for agent in agents}
    setups = tuple(
        replace(
            kart, name="", camera_mode=int(CameraMode.ON if number in karts else CameraMode.OFF)
        )
        for number, kart in enumerate(scene.setup.karts)
    )
    return replace(scene, setup=replace(scene.setup, karts=setups, num_cameras=len(karts)))
