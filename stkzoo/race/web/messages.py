"""Content of the page, and its messages as JSON values.

The race's thread makes them, and the server's thread sends them.

``docs/how-to/live-page.md`` describes each message.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.names import AttachmentType, ItemType, Phase, PowerupType
from stkzoo.render.map import road_outline
from stkzoo.render.palette import readable_on
from stkzoo.render.scene import Scene

FloatArray = npt.NDArray[np.float32]

#: Maximum number of entries of a list that the page shows; a longer list also has its length.
_MOST_ENTRIES = 12
_DEEPEST = 8
#: Enumerations of the numbers in an observation.
_LEGEND = {
    "attachment": AttachmentType,
    "items_type": ItemType,
    "phase": Phase,
    "powerup_type": PowerupType,
}
_COLUMN = {name: number for number, name in enumerate(CONTROLS)}
#: The controls that are pressed or not.
_BUTTONS = slice(2, None)


def encoded(message: Mapping[str, Any]) -> str:
    """Encodes a message as JSON text."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def race_message(scene: Scene, sources: Mapping[str, str], seed: int) -> dict[str, Any]:
    """Returns the message with the constants of a race.

    Args:
        scene: description of the race.
        sources: sources of the agents, by id.
        seed: the race's seed.
    """
    agents = {kart: f"kart_{number}" for number, kart in enumerate(scene.kart_indices)}
    karts = [
        {
            "name": scene.names[kart],
            "agent": agents.get(kart),
            "source": sources.get(agents.get(kart, ""), ""),
            "model": scene.kart_types[kart],
            "color": scene.colors[kart],
            "ink": readable_on(scene.colors[kart]),
            "label": scene.label(kart),
        }
        for kart in range(scene.num_kart)
    ]
    road, setup = road_outline(scene.track_map), scene.setup
    return {
        "type": "race",
        "title": scene.title,
        "laps": setup.laps,
        "length": round(scene.track_map.length * setup.laps, 2),
        "step_size": setup.step_size,
        "seed": seed,
        "karts": karts,
        "buttons": CONTROLS[_BUTTONS],
        "powerups": {str(powerup.value): _word(powerup.name) for powerup in PowerupType},
        "road": {
            "quads": _rounded(road.quads[road.order].reshape(-1, 8)),
            "joints": _rounded(road.joints[road.order]),
            "widths": _rounded(road.widths[road.order]),
            "shades": _rounded(road.shades()[road.order]),
            "line": _rounded(road.line),
            "forward": _rounded(road.forward, 3),
            "low": _rounded(road.low),
            "high": _rounded(road.high),
        },
    }


def trace_row(
    scene: Scene, snapshot: Snapshot, controls: FloatArray, rewards: Sequence[float]
) -> FloatArray:
    """Returns the values for the charts, ``(C, K)`` float32.

    Args:
        scene: description of the race.
        snapshot: current state.
        controls: ``(K, 7)`` float32, controls of all karts.
        rewards: sum of rewards of each kart, in grid order.

    Returns:
        The columns of :data:`COLUMNS` for all karts.
    """
    karts = snapshot.karts
    distances = _distances(scene, snapshot)
    brakes = controls[:, _COLUMN["brake"]] > 0
    throttle = np.where(brakes, -1.0, controls[:, _COLUMN["acceleration"]])
    steer = controls[:, _COLUMN["steer"]]
    gaps = distances.max() - distances
    parts = [karts["speed"], karts["position"], gaps, rewards, steer, throttle]
    return np.stack([np.asarray(part, np.float32) for part in parts])


def moment_message(
    scene: Scene, snapshot: Snapshot, steps: int, traces: FloatArray, controls: FloatArray
) -> dict[str, Any]:
    """Returns the message with the current state of a race; lists of karts are in grid order."""
    karts = snapshot.karts
    ways = (karts["front"] - karts["location"])[:, ::2]
    laps = scene.setup.laps
    length = scene.track_map.length * laps
    distance = _distances(scene, snapshot)
    finished = karts["has_finished_race"] != 0
    buttons = controls[:, _BUTTONS] > 0
    speed, rank, _, reward, steer, throttle = traces
    return {
        "type": "moment",
        "steps": steps,
        "time": _rounded(snapshot.header["time"]),
        "phase": _word(Phase(snapshot.phase).name),
        "karts": {
            "x": _rounded(karts["location"][:, 0]),
            "z": _rounded(karts["location"][:, 2]),
            "way": _rounded(np.arctan2(ways[:, 0], ways[:, 1]), 3),
            "speed": _rounded(speed),
            "rank": rank.astype(int).tolist(),
            "lap": np.clip(karts["finished_laps"] + 1, 1, laps).tolist(),
            "progress": _rounded(distance / length, 4),
            "distance": _rounded(distance),
            "finish_time": _rounded(np.where(finished, karts["finish_time"], 0.0)),
            "reward": _rounded(reward),
            "steer": _rounded(steer),
            "throttle": _rounded(throttle),
            "buttons": buttons.astype(int).tolist(),
            "nitro": _rounded(karts["energy"]),
            "powerup": karts["powerup_type"].tolist(),
        },
        "items": [
            [*place, item_type]
            for place, item_type in zip(
                _rounded(snapshot.items["location"][:, ::2], 1),
                snapshot.items["type"].tolist(),
                strict=True,
            )
        ],
    }


def _distances(scene: Scene, snapshot: Snapshot) -> FloatArray:
    """Returns the distance of each kart from the start [m], at most the race length."""
    length = scene.track_map.length * scene.setup.laps
    karts = snapshot.karts
    distances = np.where(karts["has_finished_race"] != 0, length, karts["overall_distance"])
    return np.clip(distances, 0.0, length).astype(np.float32)


def plain(value: Any, name: str = "", depth: int = 0) -> Any:
    """Converts any observation to JSON values.

    Mappings stay mappings. A list with more than 12 entries becomes a mapping with its first
    entries and its length: ``{"first": [...], "of": length}``. A number of an enumeration becomes a
    string with its name. Non-finite numbers and other values become strings.

    Args:
        value: the observation or a part of it.
        name: key of the part, which selects its enumeration.
        depth: nesting depth of the part; parts that are nested too deeply become ``"…"``.
    """
    if depth > _DEEPEST:
        return "…"
    if isinstance(value, Mapping):
        return {str(key): plain(entry, str(key), depth + 1) for key, entry in value.items()}
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, (list, tuple, np.ndarray)):
        first = [plain(entry, name, depth + 1) for entry in value[:_MOST_ENTRIES]]
        return first if len(value) <= _MOST_ENTRIES else {"first": first, "of": len(value)}
    return _leaf(value, name)


def _leaf(value: Any, name: str) -> Any:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        kinds = _LEGEND.get(name)
        if kinds is not None and value in kinds.__members__.values():
            return f"{value} {_word(kinds(int(value)).name)}"
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(f"{float(value):.5g}") if math.isfinite(value) else str(value)
    return None if value is None else str(value)[:200]


def _word(name: str) -> str:
    return name.removesuffix("_PHASE").replace("_", " ").lower()


def _rounded(values: Any, digits: int = 2) -> Any:
    """Converts numbers to rounded lists; infinite numbers and NaN become 0 for the charts."""
    array = np.nan_to_num(np.asarray(values, np.float64), posinf=0.0, neginf=0.0)
    return array.round(digits).tolist()


# ---------------------------------------------------------------------- content of the page

#: Columns of the charts. ``speed`` is in m/s. ``gap`` is the distance behind the leader [m].
#: ``reward`` is the sum since the start. ``throttle`` is the acceleration, 0 to 1, or -1 while the
#: kart brakes.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

#: Returns the text of a message; see :func:`text_of`.
Text = Callable[[], str]


class TraceLog:
    """History of a race for the charts, in bounded memory. One thread adds, others read.

    When the log is full, it drops every second entry and halves the rate of further entries.

    Args:
        most: maximum number of entries.
    """

    def __init__(self, most: int = 3000) -> None:
        self._most, self._stride = most, 1
        self._log: list[tuple[int, FloatArray]] = []

    def add(self, step: int, row: FloatArray) -> None:
        """Adds a step.

        Args:
            step: number of the step.
            row: ``(C, K)`` float32, values of all karts, in the order of :data:`COLUMNS`.
        """
        if step % self._stride:
            return
        self._log.append((step, row))
        if len(self._log) > self._most:
            self._stride *= 2
            self._log = [entry for entry in self._log if entry[0] % self._stride == 0]

    def since(self, step: int) -> dict[str, Any]:
        """Returns the entries after a step as JSON values.

        Returns:
            A dict with ``steps``, a list of numbers, and, unless it is empty, ``values``, a dict
                from column to a list over steps and karts.
        """
        log = self._log  # the race's thread may replace the list meanwhile
        entries = log[bisect_right(log, step, key=itemgetter(0)) :]
        if not entries:
            return {"steps": []}
        steps, rows = zip(*entries, strict=True)
        values = np.nan_to_num(np.stack(rows, axis=1).astype(np.float64)).round(3)
        columns = dict(zip(COLUMNS, values.tolist(), strict=True))
        return {"steps": list(steps), "values": columns}


@dataclass(frozen=True, slots=True)
class RaceNews:
    """Everything that the page shows. The race's thread replaces the object as a whole.

    Attributes:
        race: message with the race's constants; ``None`` before the race.
        agents: ids of the race's agents.
        traces: history of the race.
        moment: message with the current state; ``None`` before the race.
        steps: number of environment steps at this state.
        details: values of each agent at this state, for the page's tree.
        result: message with the race's result; ``None`` until the race has ended.
    """

    race: Text | None = None
    agents: tuple[str, ...] = ()
    traces: TraceLog = field(default_factory=TraceLog)
    moment: Text | None = None
    steps: int = 0
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    result: Text | None = None


def text_of(make_message: Callable[[], Mapping[str, Any]]) -> Text:
    """Returns a function that encodes a message on its first call and caches the text.

    All viewers share the text. Without viewers, the message is never created.
    """
    return cache(lambda: encoded(make_message()))
