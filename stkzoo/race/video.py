"""Videos of races, recorded during the race.

>>> from stkzoo.race import run_race
>>> from stkzoo.race.video import RaceVideo
>>> video = RaceVideo("race.mp4", cameras=2)
>>> result = run_race(["heuristic", "ai"], listeners=[video])  # doctest: +SKIP
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_number, check_whole
from stkzoo.engine.setup import MAX_CAMERAS
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import EngineError
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import AgentResult, RaceResult
from stkzoo.render.encoder import VideoWriter, check_video_path
from stkzoo.render.map import MapView
from stkzoo.render.motion import snapshots_between
from stkzoo.render.overlays import ResultRow, end_card, with_labels
from stkzoo.render.pictures import grid_of, tiled
from stkzoo.render.renderer import RaceRenderer, camera_karts
from stkzoo.render.scene import Scene, clock, standings
from stkzoo.wrappers.camera import checked_size

logger = logging.getLogger(__name__)

Picture = npt.NDArray[np.uint8]

_USUAL_CAMERAS = 4
_MOST_SUB_STEPS = 60
_MOST_CARD_SECONDS = 3600


class RaceVideo(RaceListener):
    """Listener that records a video of its race.

    One second of the video is one second of the race. The karts' motion between two steps is
    interpolated. The video does not affect the race. If an error ends the race, no file is written.
    After an interrupt, the file shows the race so far.

    Args:
        path: path of the video file; see :data:`stkzoo.render.encoder.FORMATS`.
        cameras: number of agents with their own tile, at most 8; ``None`` for all, up to 4. A free
            tile shows the map.
        size: width and height of the video [pixels]; odd numbers are decreased by 1.
        sub_steps: number of frames per step.
        backend: renderer of the frames: ``"engine"``, the game; ``"map"``, a top-down map;
            ``"auto"``, the game if it can render on this machine, otherwise the map.
        preset: graphics quality of the game: ``"ld"``, ``"sd"`` or ``"hd"``.
        card_seconds: duration of the results at the end [s], at most 3,600.

    Raises:
        ConfigError: an argument is invalid, or a library is missing.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        cameras: int | None = None,
        size: Sequence[int] = (854, 480),
        sub_steps: int = 3,
        backend: str = "auto",
        preset: str = "ld",
        card_seconds: float = 4.0,
    ) -> None:
        if cameras is not None:
            check_whole("cameras", cameras, 1, MAX_CAMERAS)
        check_whole("sub_steps", sub_steps, 1, _MOST_SUB_STEPS)
        check_number("card_seconds", card_seconds, 0, _MOST_CARD_SECONDS, unit="seconds")
        self.path = check_video_path(path)
        width, height = checked_size(size)
        self._size = width & ~1, height & ~1  # video formats need even sizes
        self._cameras, self._sub_steps = cameras, sub_steps
        self._card_seconds = card_seconds
        self._renderer = RaceRenderer(backend, self._size, preset)
        self._writer: VideoWriter | None = None  # since started

    @property
    def backend(self) -> str:
        """Renderer in use; may be ``"auto"`` before the first frame."""
        return self._renderer.backend

    def started(self, race: RaceProgress) -> None:
        """Starts the video with a frame of the karts on the grid.

        Raises:
            EngineError: the game cannot render, and ``backend`` does not allow the map.
            VideoError: the file cannot be written.
        """
        scene = race.scene
        wanted = min(len(scene.kart_indices), _USUAL_CAMERAS)
        cameras = wanted if self._cameras is None else self._cameras
        self._scene = replace(scene, setup=replace(scene.setup, num_cameras=cameras))
        self._karts = camera_karts(self._scene)[: max(cameras, 1)]
        self._scene = without_names(self._scene, self._karts)
        self._fps = self._sub_steps / scene.setup.step_size
        columns, rows = grid_of(len(self._karts))
        self._tile = self._size[0] // columns, self._size[1] // rows
        self._has_free_tile = 1 < len(self._karts) < columns * rows
        self._map: MapView | None = None
        self._renderer.size = self._tile
        self._renderer.begin(self._scene)
        self._writer = VideoWriter(self.path, self._fps)
        self._last = race.snapshot
        self._write(self._last)

    def stepped(self, race: RaceProgress) -> None:
        """Adds the frames of one step.

        Raises:
            EngineError: the render process crashed twice in a row.
            VideoError: the file cannot be written.
        """
        for between in snapshots_between(self._last, race.snapshot, self._sub_steps):
            self._write(between)
        self._last = race.snapshot

    def ended(self, result: RaceResult) -> None:
        """Adds the results, then completes the file and moves it to its path.

        Raises:
            VideoError: the file cannot be written.
        """
        if self._writer is None:
            return
        how = {"finished": "", "interrupted": ", interrupted"}.get(result.status, ", cut short")
        subtitle = f"results after {clock(float(self._last.header['time']))}{how}"
        rows = self._rows(result.agents)
        card = end_card(self._scene.title, subtitle, rows, self._last_picture, self._size)
        for _ in range(round(self._card_seconds * self._fps)):
            self._put(card)
        self._writer.close()

    def closed(self) -> None:
        """Discards the video unless :meth:`ended` completed it."""
        if self._writer is not None:
            self._writer.abort()
        self._renderer.close()

    def _rows(self, agents: Sequence[AgentResult]) -> list[ResultRow]:
        """Returns result rows, computed from the last snapshot and the agents that have retired."""
        numbers = (int(row.agent.split("_")[1]) for row in agents if row.status == "retired")
        retired = {self._scene.kart_indices[number] for number in numbers}
        return sorted(
            (
                line.rank,
                line.name,
                line.color,
                f"retired, {line.outcome}" if line.kart in retired else line.outcome,
            )
            for line in standings(self._scene, self._last)
        )

    def _frames(self, snapshot: Snapshot) -> dict[int, Picture] | None:
        """Renders the game's frames; restarts the render process once if it fails."""
        try:
            return self._renderer.game_pictures(snapshot)
        except EngineError as error:
            logger.warning("the render process failed and is restarted: %s", error)
            return self._renderer.game_pictures(snapshot)

    def _write(self, snapshot: Snapshot) -> None:
        by_kart = self._frames(snapshot)
        if by_kart is None:
            picture = self._map_picture(snapshot, self._size, panel=True)
        else:
            tiles = [by_kart[kart] for kart in self._karts]
            if self._has_free_tile:
                tiles.append(self._map_picture(snapshot, self._tile, panel=False))
            picture = with_labels(tiled(tiles, self._size), self._scene, snapshot, self._karts)
        self._last_picture = picture
        self._put(picture)

    def _map_picture(self, snapshot: Snapshot, size: tuple[int, int], *, panel: bool) -> Picture:
        self._map = self._map or MapView(self._scene, size, panel=panel)
        self._map.remember(snapshot)
        return self._map.draw(snapshot)

    def _put(self, picture: Picture) -> None:
        assert self._writer is not None  # noqa: S101 - since started
        self._writer.add(picture)


def without_names(scene: Scene, filmed: Sequence[int]) -> Scene:
    """Removes the game's name tags of filmed karts, because labels show these names."""
    karts = tuple(
        replace(setup, name="") if kart in filmed else setup
        for kart, setup in enumerate(scene.setup.karts)
    )
    return replace(scene, setup=replace(scene.setup, karts=karts))
