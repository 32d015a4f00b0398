"""Agents' cameras: each moment is rendered once for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from stkzoo.engine.setup import MAX_CAMERAS
from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.episode import Episode
from stkzoo.env.rendering import scene_of
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.names import CameraMode
from stkzoo.render.renderer import RaceRenderer
from stkzoo.render.scene import Scene
from stkzoo.wrappers.camera import Camera, CameraKind, Shot

if TYPE_CHECKING:
    from stkzoo.env.race import Race


class RaceCameras:
    """The cameras of all agents of one environment.

    Args:
        agents: ids of all agents.

    Attributes:
        by_agent: the camera of each agent.
        race: the race, by a weak reference.
    """

    race: Race

    def __init__(self, agents: Sequence[str]) -> None:
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
