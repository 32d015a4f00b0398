"""Runs Gymnasium's benchmark functions on the single-kart ids, and measures the cost of cameras.

    python -m benchmarks.bench_tool_belt
    python -m benchmarks.bench_tool_belt --seconds 3 --rounds 3

The benchmark uses ``benchmark_step``, ``benchmark_init`` and ``benchmark_render`` of
``gymnasium.utils.performance`` unchanged: with random actions, and a first reset in each init.
pystk2-gymnasium has the same ids but does not render. ``cameras`` compares a step of a race whose
agents all have cameras (``CameraObservations``), 84 by 84 pixels, with the same race without
cameras. Every figure comes from a separate interpreter; contenders take turns.
"""

from __future__ import annotations

import argparse
import importlib
import json
import statistics
import sys
import time
import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any

from benchmarks.bench_common import Table, parser, print_tables, progress_bar, save
from benchmarks.bench_driver import answer_of, engine_variables

_IDS = ("full", "flattened", "flattened_discrete")
_LIBRARIES = {"stkzoo": "stkzoo", "reference": "pystk2_gymnasium"}
_CAMERAS: dict[str, dict[str, Any] | None] = {
    "no camera": None,
    "the map": {"backend": "map"},
    "the game": {"backend": "engine"},
    "the game, every 3 steps": {"backend": "engine", "every": 3},
    "the game and depth": {"backend": "engine", "depth": True},
}
_FULL_THROTTLE = 484  # in flattened_discrete
_WARM_UP = 5


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "tool_belt", steps=60, karts=(1, 4))
    words.add_argument("--seconds", type=int, default=2, help="per measurement (default: 2)")
    words.add_argument("--rounds", type=int, default=3, help="measurements of each (default: 3)")
    words.add_argument("--contender", help=argparse.SUPPRESS)
    options = words.parse_args(arguments)
    if options.contender:
        print(json.dumps(_measure(json.loads(options.contender), options)))
        return 0
    todo = _contenders(options)
    found: list[list[float]] = [[] for _ in todo]
    with progress_bar(len(todo) * options.rounds) as (bar, task):
        for _ in range(options.rounds):
            for spec, values in zip(todo, found, strict=True):
                bar.update(task, description=" ".join(map(str, spec.values())))
                values.append(_in_an_interpreter_of_its_own(spec, options))
                bar.advance(task)
    results = [
        {**spec, "values": values, "median": statistics.median(values)}
        for spec, values in zip(todo, found, strict=True)
    ]
    print_tables(tables(results))
    del options.contender
    save(options.output, "tool_belt", options, results)
    return 0


def _contenders(options: argparse.Namespace) -> list[dict[str, Any]]:
    rates = [
        {"group": what, "who": who, "id": name}
        for what in ("step", "init")
        for name in _IDS
        for who in _LIBRARIES
    ]
    pictures = [{"group": "render", "who": who, "id": "full"} for who in ("map", "engine")]
    cameras = [
        {"group": "cameras", "who": who, "karts": karts}
        for karts in options.karts
        for who in _CAMERAS
    ]
    return [*rates, *pictures, *cameras]


def _in_an_interpreter_of_its_own(spec: Mapping[str, Any], options: argparse.Namespace) -> float:
    words = ["--track", options.track, "--seconds", str(options.seconds)]
    words += ["--steps", str(options.steps)]
    # Rendering needs the full game data, which stkzoo finds by itself.
    variables = engine_variables() if spec["who"] == "reference" else {}
    return answer_of("bench_tool_belt", spec, words, variables)


def _measure(spec: Mapping[str, Any], options: argparse.Namespace) -> float:
    """Returns calls per second; for cameras, the time of a step [ms]."""
    if spec["group"] == "cameras":
        return _camera_step(spec, options)
    import gymnasium as gym
    from gymnasium.utils import performance

    warnings.simplefilter("ignore")  # the reference warns at every step
    importlib.import_module(_LIBRARIES.get(spec["who"], "stkzoo"))
    race: dict[str, Any] = {"track": options.track, "num_kart": 3}
    name = f"supertuxkart/{spec['id']}-v0"
    if spec["group"] == "init":
        return performance.benchmark_init(partial(_made, gym, name, race), options.seconds, 1)
    if spec["group"] == "render":
        race |= {"render_mode": "rgb_array", "render_backend": spec["who"]}
    env = gym.make(name, **race)
    try:
        if spec["group"] == "step":
            env.action_space.seed(1)  # benchmark_step does not seed it
            return performance.benchmark_step(env, options.seconds, seed=1)
        env.reset(seed=1)
        env.render()  # starts the render process
        return performance.benchmark_render(env, options.seconds)
    finally:
        env.close()


class _Made:
    """Holds the latest environment, which is closed before the next one is made."""

    env: Any = None


def _made(gym: Any, name: str, race: Mapping[str, Any]) -> Any:
    if _Made.env is not None:
        _Made.env.close()
    _Made.env = gym.make(name, **race)
    return _Made.env


def _camera_step(spec: Mapping[str, Any], options: argparse.Namespace) -> float:
    from stkzoo import race_v0

    view: Any = "flattened_discrete"
    if (camera := _CAMERAS[spec["who"]]) is not None:
        view = partial(_filmed, camera)
    with race_v0.parallel_env(num_kart=spec["karts"], track=options.track, view=view) as env:
        env.reset(seed=1)
        for step in range(_WARM_UP + options.steps):
            if step == _WARM_UP:
                begin = time.perf_counter()
            env.step(dict.fromkeys(env.agents, _FULL_THROTTLE))
        return 1000 * (time.perf_counter() - begin) / options.steps


def _filmed(camera: Mapping[str, Any], env: Any) -> Any:
    from stkzoo.views import VIEWS
    from stkzoo.wrappers import CameraObservations

    return CameraObservations(VIEWS["flattened_discrete"](env), **camera)


def tables(results: list[dict[str, Any]]) -> list[Table]:
    """Returns the results as tables."""
    rates = [row for row in results if row["group"] != "cameras"]
    cameras = [row for row in results if row["group"] == "cameras"]
    return [
        Table(
            "Gymnasium's benchmark functions, calls a second",
            ("function", "id", "who", "a second"),
            [
                (f"benchmark_{row['group']}", row["id"], row["who"], f"{row['median']:.1f}")
                for row in rates
            ],
        ),
        Table(
            "A step with cameras of 84 x 84 pixels, ms",
            ("agents", "who draws", "ms"),
            [(str(row["karts"]), row["who"], f"{row['median']:.1f}") for row in cameras],
        ),
    ]


if __name__ == "__main__":
    sys.exit(main())
