"""A top-down map of a race: track, karts, items, trails and standings in one frame."""

from __future__ import annotations

from collections import deque
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.render.overlays import draw_panel, panel_width
from stkzoo.render.palette import readable_on, rgb
from stkzoo.render.pictures import font_of, pillow
from stkzoo.render.scene import Scene

if TYPE_CHECKING:
    from PIL.Image import Image


#: Oversampling factor for anti-aliasing.
_FINE = 2
_BACKGROUND, _KERB = (18, 23, 32), (196, 206, 220)
_ROAD_LOW, _ROAD_HIGH = np.array([47, 57, 74]), np.array([112, 127, 150])
_MARGIN = 0.05  # margin around the track, as a fraction of the frame
_FOLLOWED = 90.0  # [m], width of a frame that follows a kart
_TRAIL = 30  # length of a trail in snapshots
#: Color and radius [m] by number of stkzoo.names.ItemType.
_ITEMS = {
    0: ("#ff9f43", 1.5),
    1: ("#ffe14d", 1.0),
    2: ("#4de1ff", 1.4),
    3: ("#4de1ff", 1.0),
    4: ("#ff7eb6", 1.0),
    6: ("#b8f28c", 1.0),
}


class MapView:
    """Draws the moments of one race.

    The track is drawn once; after that, a frame takes a few milliseconds.

    Args:
        scene: the race.
        size: width and height of a frame [pixels].
        follow: kart to keep in the center of the frame, as an index in grid order; ``None`` shows
            the whole track.
        panel: whether to show the standings, if the frame is wide enough.
    """

    def __init__(
        self,
        scene: Scene,
        size: tuple[int, int] = (640, 480),
        *,
        follow: int | None = None,
        panel: bool = True,
    ) -> None:
        self._pil = pillow()
        self._scene, self._follow = scene, follow
        self._road = road_outline(scene.track_map)
        self._size = size
        self._panel = panel_width(size) if panel else 0
        self._width, self._height = size[0] - self._panel, size[1]
        self._trail: deque[npt.NDArray[np.float32]] = deque(maxlen=_TRAIL)
        self._scale, self._center = self._whole_track()
        if follow is not None:
            self._scale = _FINE * self._width / _FOLLOWED
        self._ground: Image | None = None
        self._label = font_of(max(9, min(size) // 40) * _FINE)

    def remember(self, snapshot: Snapshot) -> None:
        """Records a snapshot for the trails without drawing it."""
        self._trail.append(snapshot.karts["location"][:, ::2].copy())

    def draw(self, snapshot: Snapshot) -> npt.NDArray[np.uint8]:
        """Returns the frame of a snapshot, ``(height, width, 3)`` uint8."""
        if self._follow is not None:
            self._center = snapshot.karts["location"][self._follow, ::2]
        canvas = self._backdrop()
        draw = self._pil.ImageDraw.Draw(canvas)
        self._draw_items(draw, snapshot)
        self._draw_trails(draw, snapshot)
        self._draw_karts(draw, snapshot)
        small = canvas.reduce(_FINE)
        if not self._panel:
            return np.asarray(small)
        whole = self._pil.Image.new("RGB", self._size, _BACKGROUND)
        whole.paste(small, (0, 0))
        draw_panel(whole, self._scene, snapshot, self._width)
        return np.asarray(whole)

    # ------------------------------------------------------------------ the ground

    def _whole_track(self) -> tuple[float, npt.NDArray[np.float32]]:
        extent = np.maximum(self._road.high - self._road.low, 1.0)
        room = np.array([self._width, self._height]) * (1 - 2 * _MARGIN)
        return _FINE * float((room / extent).min()), (self._road.low + self._road.high) / 2

    def _backdrop(self) -> Image:
        if self._follow is not None:
            reach = max(self._width, self._height) * _FINE / self._scale / 2
            return self._draw_ground(self._road.near(self._center, reach + 5.0))
        if self._ground is None:
            self._ground = self._draw_ground(np.ones(len(self._road.quads), bool))
        return self._ground.copy()

    def _draw_ground(self, shown: npt.NDArray[np.bool_]) -> Image:
        size = self._width * _FINE, self._height * _FINE
        canvas: Image = self._pil.Image.new("RGB", size, _BACKGROUND)
        draw = self._pil.ImageDraw.Draw(canvas)
        pieces = [piece for piece in self._road.order.tolist() if shown[piece]]
        quads, joints = self._pixels(self._road.quads), self._pixels(self._road.joints)
        radii = self._road.widths * self._scale / 2
        kerb = max(1.5, 0.35 * self._scale)
        for piece in pieces:
            _outline(draw, quads[piece], kerb)
            _disc(draw, joints[piece], radii[piece] + kerb / 2, _KERB)
        shades = self._road.shades()[:, None]
        colors = (_ROAD_LOW + shades * (_ROAD_HIGH - _ROAD_LOW)).astype(int).tolist()
        for piece in pieces:
            color = tuple(colors[piece])
            draw.polygon([tuple(point) for point in quads[piece].tolist()], fill=color)
            _disc(draw, joints[piece], radii[piece] - kerb / 2, color)
        self._draw_start(draw)
        return canvas

    def _draw_start(self, draw: Any) -> None:
        """Draws two rows of black and white squares across the road."""
        left, right = self._road.line
        deep = max(1.2, 5 / self._scale)
        squares = max(4, round(float(np.linalg.norm(right - left)) / deep))
        steps = np.linspace(left, right, squares + 1)
        for row in (0, 1):
            for column in range(squares):
                near = steps[column : column + 2] + self._road.forward * deep * (row - 1)
                corners = np.concatenate([near, near[::-1] + self._road.forward * deep])
                color = (240, 240, 240) if (row + column) % 2 else (24, 24, 24)
                draw.polygon([tuple(p) for p in self._pixels(corners).tolist()], fill=color)

    # ------------------------------------------------------------------ moving objects

    def _draw_items(self, draw: Any, snapshot: Snapshot) -> None:
        places = self._pixels(snapshot.items["location"][:, ::2])
        for place, item_type in zip(places, snapshot.items["type"].tolist(), strict=True):
            color, radius = _ITEMS.get(item_type, ("#ffffff", 1.0))
            size = max(radius * self._scale, 1.6 * _FINE)
            if item_type == 0:
                x, y = place
                draw.rectangle([x - size, y - size, x + size, y + size], fill=rgb(color))
            else:
                _disc(draw, place, size, rgb(color))

    def _draw_trails(self, draw: Any, snapshot: Snapshot) -> None:
        if len(self._trail) < 2 or self._trail[-1].shape[0] != len(snapshot.karts):
            return
        lines = self._pixels(np.stack(self._trail))
        width = max(_FINE, round(self._radius() / 2))
        longest = 12.0 * self._scale  # a longer distance is a reset of the kart
        fades = np.linspace(0.15, 0.75, len(lines))
        for kart, name in enumerate(self._scene.colors):
            color = np.array(rgb(name))
            for fade, start, end in zip(fades, lines[:-1, kart], lines[1:, kart], strict=False):
                if np.abs(end - start).max() < longest:
                    mixed = tuple((_ROAD_LOW + fade * (color - _ROAD_LOW)).astype(int).tolist())
                    draw.line([tuple(start), tuple(end)], fill=mixed, width=width)

    def _draw_karts(self, draw: Any, snapshot: Snapshot) -> None:
        karts = snapshot.karts
        places = self._pixels(karts["location"][:, ::2])
        ways = (karts["front"] - karts["location"])[:, ::2] * [1, -1]
        ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
        for kart in np.argsort(-karts["position"], kind="stable").tolist():
            self._draw_kart(draw, kart, places[kart], ways[kart])

    def _draw_kart(self, draw: Any, kart: int, place: Any, way: Any) -> None:
        """Draws a disc with a pointer ahead and the agent's number."""
        name = self._scene.colors[kart]
        radius = self._radius()
        across = np.array([-way[1], way[0]])
        for grown, color in ((1.35, (10, 13, 18)), (1.0, rgb(name))):
            size = radius * grown
            tip = place + way * (radius * 1.9 + size - radius)
            nose = [tip, place + across * size * 0.92, place - across * size * 0.92]
            draw.polygon([tuple(point) for point in nose], fill=color)
            _disc(draw, place, size, color)
        label = self._scene.label(kart)
        if label:
            draw.text(tuple(place), label, readable_on(name), font=self._label, anchor="mm")

    def _radius(self) -> float:
        """Radius of a kart's disc on the oversampled canvas, with room for its number [pixels]."""
        return max(1.1 * self._scale, float(self._label.size) * 0.62)

    def _pixels(self, points: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Converts points ``(..., 2)`` of x and z [m] to the oversampled canvas; z points up."""
        middle = np.array([self._width, self._height]) * _FINE / 2
        flat: npt.NDArray[np.float64] = (points - self._center) * [self._scale, -self._scale]
        return flat + middle


def _disc(draw: Any, place: Any, radius: float, color: Any) -> None:
    if radius < 0:  # a narrow road in a small frame is all kerb
        return
    x, y = place
    draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill=color)


def _outline(draw: Any, quad: Any, kerb: float) -> None:
    """Draws the left and right kerbs of a road segment."""
    points = [tuple(point) for point in quad.tolist()]
    draw.polygon(points, fill=_KERB)
    for start, end in ((0, 3), (1, 2)):
        draw.line([points[start], points[end]], fill=_KERB, width=max(1, round(2 * kerb)))


FloatArray = npt.NDArray[np.float32]

#: Segment ends closer than this are drawn as one point [m].
_JOINT = 16.0
#: Smallest and largest width at which a road is drawn [m].
_WIDTHS = 3.0, 60.0


class RoadOutline:
    """The segments of the driving line as quadrilaterals. Points are ``(x, z)`` [m], world frame.

    Attributes:
        quads: ``(N, 4, 2)``, left and right corner at the start, then right and left at the end.
        joints: ``(N, 2)``, center of each segment's start.
        widths: ``(N,)`` [m].
        heights: ``(N,)`` height at each segment's middle [m].
        order: ``(N,)``, segments from the lowest to the highest.
        low, high: ``(2,)``, corners of the bounding box.
        line: ``(2, 2)``, left and right end of the start line.
        forward: ``(2,)``, driving direction at the start line.
    """

    def __init__(self, track: TrackMap) -> None:
        starts, ends = track.path_nodes[:, 0, ::2], track.path_nodes[:, 1, ::2]
        self.widths = np.clip(track.path_width[:, 0], *_WIDTHS)
        self.heights = track.path_nodes[:, :, 1].mean(1)
        self.joints = starts
        ways = _unit(ends - starts)
        at_start = _mean_ways(ways, track)
        side = _right_of(at_start) * self.widths[:, None] / 2
        left, right = starts - side, starts + side
        far = _right_of(ways) * self.widths[:, None] / 2
        far_left, far_right = ends - far, ends + far
        for node, followers in enumerate(track.successors):
            if followers:
                gaps = np.linalg.norm(starts[list(followers)] - ends[node], axis=1)
                nearest = followers[int(np.argmin(gaps))]
                if gaps.min() < _JOINT:
                    far_left[node], far_right[node] = left[nearest], right[nearest]
        self.quads = np.stack([left, right, far_right, far_left], axis=1)
        self.order = np.argsort(self.heights, kind="stable")
        corners = self.quads.reshape(-1, 2)
        self.low, self.high = corners.min(0), corners.max(0)
        first = int(np.argmin(track.path_distance[:, 0]))
        self.line = np.stack([left[first], right[first]])
        self.forward = at_start[first]

    def shades(self) -> FloatArray:
        """``(N,)``, 0 for the lowest and 1 for the highest segment; 0.5 on flat tracks."""
        low, high = float(self.heights.min()), float(self.heights.max())
        if high - low < 2.0:
            return np.full(len(self.heights), 0.5, np.float32)
        return np.asarray((self.heights - low) / (high - low), np.float32)

    def near(self, center: FloatArray, reach: float) -> npt.NDArray[np.bool_]:
        """Returns whether each segment is within ``reach`` meters of a point, ``(N,)`` bool."""
        low, high = self.quads.min(1), self.quads.max(1)
        near: npt.NDArray[np.bool_] = ((low < center + reach) & (high > center - reach)).all(1)
        return near


@lru_cache(maxsize=32)
def road_outline(track: TrackMap) -> RoadOutline:
    """Returns the outline of a track's road; cached."""
    return RoadOutline(track)


def _mean_ways(ways: FloatArray, track: TrackMap) -> FloatArray:
    """Returns directions at the joints: the mean over a segment and its predecessors."""
    sums = ways.copy()
    for node, followers in enumerate(track.successors):
        for follower in followers:
            if float(ways[node] @ ways[follower]) > 0:
                sums[follower] += ways[node]
    return _unit(sums)


def _unit(vectors: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-6), np.float32)


def _right_of(ways: FloatArray) -> FloatArray:
    """Returns the directions to the right; when driving along z, x is to the right."""
    return np.stack([ways[:, 1], -ways[:, 0]], axis=1)
