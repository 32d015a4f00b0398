"""Checks random starts on all tracks: whether each kart starts and drives as requested.

    python -m benchmarks.starts            # 1,000 starts; writes benchmarks/results/starts.json

Each start is drawn on a track (share of the lap, speed, offset and heading). The benchmark checks
the distance between the requested position and the kart, its speed, its lap, and that it is still
at the height of the road after two seconds with the heuristic driver. It counts draws that the game
rejects because there is no ground.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo import Start, race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.agents import heuristic
from stkzoo.engine.starting import CenterLine
from stkzoo.errors import ConfigError
from stkzoo.names import AttachmentType
from stkzoo.tracks import SPLITS

RESULTS = Path(__file__).parent / "results" / "starts.json"

NOTHING = int(AttachmentType.NOTHING)
_DRIVEN_STEPS = 20
_HEIGHT = 4.0  # above or below the road; jumps are high [m]


def main() -> None:
    parser = CommandParser(prog="python -m benchmarks.starts", description=__doc__)
    parser.add_argument("--starts", type=int, default=1000, help="total number of starts")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--track", dest="tracks", nargs="+", default=list(SPLITS["all"]))
    parser.add_argument("--reverse", action="store_true", help="reverse the tracks")
    parser.add_argument("--output", type=Path, default=RESULTS)
    arguments = parser.parse_args()
    rows = []
    for number, track in enumerate(arguments.tracks):
        share = arguments.starts * (number + 1) // len(arguments.tracks)
        count = share - arguments.starts * number // len(arguments.tracks)
        rows.append(track_starts(track, count, arguments.seed + number, arguments.reverse))
        print(json.dumps({key: value for key, value in rows[-1].items() if key != "bad"}))
        for bad in rows[-1]["bad"]:
            print("   ", bad, flush=True)
    write(arguments.output, summary(rows))


def track_starts(track: str, count: int, seed: int, reverse: bool = False) -> dict[str, Any]:
    """Checks random starts on a track."""
    random = np.random.default_rng(seed)
    row: dict[str, Any] = {
        "track": track,
        "starts": 0,
        "refused": 0,
        "fallen": 0,
        "items": 0,
        "bad": [],
    }
    away, speeds = [0.0], [0.0]
    with race_v0.parallel_env(num_kart=1, track=track, reverse=reverse) as env:
        while row["starts"] < count:
            start = Start(
                share=float(random.uniform(0.0, 1.0)),
                speed=float(random.uniform(0.0, 15.0)),
                offset=float(random.uniform(-1.0, 1.0)),
                heading=float(random.uniform(-0.3, 0.3)),
            )
            try:
                observations, _ = env.reset(seed=seed, options={"start": start})
            except ConfigError:
                row["refused"] += 1
                continue
            row["starts"] += 1
            error, lag, laps = _errors(env, start)
            away.append(error)
            speeds.append(lag)
            kart = env.snapshot.karts[0]
            took = kart["powerup_num"] > 0 or kart["attachment_type"] != NOTHING
            row["items"] += int(took)
            off_road = _drive(env, observations)
            row["fallen"] += off_road > _HEIGHT
            if error > 2.0 or lag > 1.0 or laps != 0 or off_road > _HEIGHT:
                row["bad"].append([start.share, round(start.speed, 1), error, lag, laps, off_road])
        row["finishes"] = _finishes(env, seed)
    return row | {"max_away": round(max(away), 3), "max_speed_error": round(max(speeds), 3)}


def _finishes(env: Any, seed: int) -> bool:
    """Returns whether a kart that starts late in the lap finishes when it crosses the line."""
    for share in (0.9, 0.88, 0.92, 0.86):
        try:
            observations, _ = env.reset(seed=seed, options={"start": Start(share=share)})
            break
        except ConfigError:
            continue
    driver = heuristic.create_state()
    ended = {"kart_0": False}
    for _ in range(600):
        action = driver.drive(observations["kart_0"])
        observations, _, ended, _, _ = env.step({"kart_0": action})
        if not env.agents:
            break
    return bool(ended["kart_0"])


def _errors(env: Any, start: Start) -> tuple[float, float, int]:
    """Returns the errors of position [m] and speed [m/s], and the number of finished laps."""
    road, kart = CenterLine(env.track_map), env.snapshot.karts[0]
    distance = (start.share or 0.0) * road.length
    along = road.direction(distance)
    right = np.array([along[2], 0.0, -along[0]]) / math.hypot(along[0], along[2])
    away = np.asarray(kart["location"], float) - road.point(distance) - start.offset * right
    lag = abs(float(kart["velocity_lc"][2]) - start.speed)
    return round(float(np.linalg.norm(away)), 3), round(lag, 3), int(kart["finished_laps"])


def _drive(env: Any, observations: dict[str, Any]) -> float:
    """Drives some steps; returns how far the kart is above or below the road [m]."""
    driver = heuristic.create_state()
    for _ in range(_DRIVEN_STEPS):
        if not env.agents:
            break
        action = driver.drive(observations["kart_0"])
        observations, *_ = env.step({"kart_0": action})
    kart, track = env.snapshot.karts[0], env.track_map
    middles = track.path_nodes.mean(axis=1)
    near = np.argsort(np.linalg.norm(middles - kart["location"], axis=1))[:4]
    heights = track.path_nodes[near][:, :, 1]
    low, high = float(heights.min()), float(heights.max())
    height = float(kart["location"][1])
    return round(max(low - height, height - high, 0.0), 3)


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "starts": sum(row["starts"] for row in rows),
        "refused": sum(row["refused"] for row in rows),
        "fallen": sum(row["fallen"] for row in rows),
        "items": sum(row["items"] for row in rows),
        "finishes": all(row["finishes"] for row in rows),
        "max_away": max(row["max_away"] for row in rows),
        "max_speed_error": max(row["max_speed_error"] for row in rows),
        "tracks": rows,
    }


def write(path: Path, results: dict[str, Any]) -> None:
    write_text(path, json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
