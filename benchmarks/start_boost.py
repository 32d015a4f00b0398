"""Measures whether agents get the game's start boost and slipstream bonus, in both modes.

    python -m benchmarks.start_boost          # writes results/start_boost.json

Start boost: one kart presses the throttle at different times before and after the start, and with
random buttons before the start. The speed 1 s after the start shows whether it got the boost. The
game's AI starts for comparison. Slipstream: a kart follows another one closely on a straight at
full throttle. The bonus would raise its top speed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.step_responses import STRAIGHT, game_action
from stkzoo import AgentSpec, Start, race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.config import RACE_MODES
from stkzoo.engine.track import TrackMap
from stkzoo.names import Phase
from stkzoo.records import RECORD_DIFFICULTY, RECORD_KART

OUTPUT = Path(__file__).parent / "results" / "start_boost.json"
STEP = 0.05
#: Times of the first throttle after the first step [s]; the race starts at 1.95 s.
THROTTLE = [round(0.2 * number, 1) for number in range(13)]
PATTERNS, HORIZON = 30, 90
#: Position of the follower on the straight [m], gaps to the kart ahead [m], and steps of 0.1 s.
STRAIGHT_FROM, GAPS, FOLLOWED = 186.0, (4.0, 6.0, 8.0, 10.0, 60.0), 70
#: Step at which the follower moves out of the slipstream, and by how much [m].
ASIDE_AFTER, ASIDE = 40, 4.0


def main() -> None:
    parser = CommandParser(prog="python -m benchmarks.start_boost", description=__doc__)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    output = parser.parse_args().output
    results = {mode: measure(mode) for mode in RACE_MODES}
    write_text(output, json.dumps(results, indent=1) + "\n")
    for mode, found in results.items():
        fastest = max(found["throttle"].values())
        print(f"{mode}: 1 s after the start, AI {found['ai']:.2f} m/s, an agent at most ", end="")
        print(f"{fastest:.2f} m/s, with random buttons {found['random_buttons']:.2f} m/s")
        print(f"  top speed behind a kart, by the gap [m]: {found['slipstream']}")


def measure(mode: str) -> dict[str, Any]:
    """Returns all figures in a mode."""
    with start_race(mode, is_ai=False) as env:
        throttle = {str(seconds): speed_after_start(env, seconds) for seconds in THROTTLE}
        random = np.random.default_rng(0)
        buttons = max(speed_after_start(env, 0.0, random) for _ in range(PATTERNS))
    with start_race(mode, is_ai=True) as env:
        ai = speed_after_start(env, 0.0)
    slipstream = {str(gap): top_speed_behind(mode, gap) for gap in GAPS}
    return {"ai": ai, "throttle": throttle, "random_buttons": buttons, "slipstream": slipstream}


def start_race(mode: str, *, is_ai: bool) -> Any:
    return race_v0.parallel_env(
        agents=[AgentSpec(0, is_ai, kart=RECORD_KART)],
        num_kart=1,
        track="lighthouse",
        mode=mode,
        difficulty=RECORD_DIFFICULTY,
        step_size=STEP,
        laps=3,
    )


def speed_after_start(
    env: Any, throttle_at: float, random: np.random.Generator | None = None
) -> float:
    """Returns the speed 1 s after the start [m/s]; ``random`` presses buttons before the start."""
    env.reset(seed=1)
    pressed = () if random is None else sorted(random.integers(0, 45, 2))
    buttons = {} if random is None else dict(zip(BUTTONS, random.integers(0, 2, 4), strict=True))
    started = None
    for step in range(HORIZON):
        if random is None:
            action = game_action(float(step * STEP >= throttle_at))
        elif started is not None:
            action = game_action(1.0)
        else:
            held = pressed[0] <= step < pressed[1]
            action = game_action(float(held and buttons["throttle"]))
            action |= {name: int(held and buttons[name]) for name in BUTTONS[1:]}
        env.step({"kart_0": action})
        if started is None and env.snapshot.phase >= Phase.GO_PHASE:
            started = step
        if started is not None and step - started == round(1 / STEP):
            return round(float(env.snapshot.karts["speed"][0]), 3)
    raise RuntimeError("the race did not start")


#: Buttons of the random patterns; a zipper (``fire``) would hide the start boost.
BUTTONS = ("throttle", "brake", "drift", "nitro")


def top_speed_behind(mode: str, gap: float) -> float:
    """Returns the top speed of a kart that starts ``gap`` meters behind another one [m/s]."""
    starts = {
        "kart_0": Start(distance=STRAIGHT_FROM + gap, speed=25.0),
        "kart_1": Start(distance=STRAIGHT_FROM, speed=25.0),
    }
    with race_v0.parallel_env(
        agents=[AgentSpec(0, kart=RECORD_KART), AgentSpec(1, kart=RECORD_KART)],
        num_kart=2,
        track=STRAIGHT,
        mode=mode,
        difficulty=RECORD_DIFFICULTY,
        start=starts,
    ) as env:
        env.reset(seed=1)
        fastest = 0.0
        for step in range(FOLLOWED):
            aside = ASIDE if step >= ASIDE_AFTER else 0.0
            steers = [steer(env, 0, 0.0), steer(env, 1, aside)]
            env.step({f"kart_{n}": game_action(1.0, turn) for n, turn in enumerate(steers)})
            fastest = max(fastest, float(env.snapshot.karts["speed"][1]))
    return round(fastest, 3)


def steer(env: Any, kart: int, aside: float) -> float:
    """Returns the steering toward a point 10 m ahead, ``aside`` meters right of the center line."""
    road: TrackMap = env.track_map
    along = road.path_nodes[:, 1] - road.path_nodes[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    karts = env.snapshot.karts
    distance = float(karts["distance_down_track"][kart]) + 10.0
    begins = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    node = int(np.searchsorted(begins, distance)) - 1
    share = (distance - begins[node]) / lengths[node]
    right = np.array([along[node, 2], 0.0, -along[node, 0]]) / lengths[node]
    target = road.path_nodes[node, 0] + share * along[node] + aside * right
    way = target - karts["location"][kart]
    front = karts["front"][kart] - karts["location"][kart]
    angle = np.arctan2(way[0], way[2]) - np.arctan2(front[0], front[2])
    angle = (angle + np.pi) % (2 * np.pi) - np.pi
    return float(np.clip(3.0 * angle, -1.0, 1.0))


if __name__ == "__main__":
    main()
