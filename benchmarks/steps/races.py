"""Steps of the same race in several contenders.

All contenders run the same race with the same actions, a few steps each in turn, so that noise on
the machine affects all of them equally. The results state whether all karts drove the same
distance, bit for bit. The ratio of a step is its time over the time spent inside
``pystk2.Race.step`` in that step. Compilation and the first steps are not counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common import Result, Table, cores, figures, quantiles, spread
from benchmarks.contenders.controls import PHYSICAL, driving_style
from benchmarks.contenders.driver import Spec, contenders, race_together
from benchmarks.steps.sections import REFERENCE_VIEWS, VIEWS, Job, Section
from stkzoo.tracks import SPLITS

#: ``parallel`` is stkzoo's ParallelEnv in each view with all karts as agents. ``multi`` is the id
#: multi-full-v0 with all karts as agents, in stkzoo and in the reference. ``single`` are the ids
#: with one agent in each view of the reference, in both; the game drives the other karts.
GROUPS = ("parallel", "multi", "single")
#: Numbers of karts of the group ``single``.
_SINGLE_KARTS = (1, 3)
_ENGINE, _HERE, _THERE = "engine", "stkzoo, in process", "stkzoo, worker"

# ---------------------------------------------------------------------- steps


def _step_jobs(options: argparse.Namespace) -> list[Job]:
    views = {
        "parallel": options.view,
        "multi": ["full"],
        "single": [view for view in options.view if view in REFERENCE_VIEWS],
    }
    return [
        {"group": group, "view": view, "karts": karts}
        for karts in options.karts
        for group in options.group
        if group != "single" or karts in _SINGLE_KARTS
        for view in views[group]
    ]


def _step_specs(group: str, view: str, karts: int, pinned: tuple[int, ...]) -> dict[str, Spec]:
    def spec(kind: str, subprocess: bool = False, events: bool = False) -> Spec:
        num_agents = 1 if group == "single" else karts
        return Spec(kind, group, view, karts, num_agents, subprocess, pinned, events)

    # Controls of the views `control` and `flattened_control` depend on the kart's state to the last
    # bit, so these races have no engine to compare with.
    specs = {} if driving_style(view) == PHYSICAL else {_ENGINE: spec("bare")}
    specs |= {_HERE: spec("stkzoo"), _THERE: spec("stkzoo", subprocess=True)}
    if group == "parallel":
        specs["stkzoo, events"] = spec("stkzoo", events=True)
    # The reference's fixed-size views fail in a race without other karts.
    if group == "multi" or (group == "single" and (karts > 1 or view == "full")):
        specs["reference, in process"] = spec("reference")
        specs["reference, subprocess"] = spec("reference", subprocess=True)
    return specs


def _measure_steps(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    specs = _step_specs(job["group"], job["view"], job["karts"], cores(options.cores[0]))
    with contenders(specs) as started:
        times, is_same = race_together(started, options.track[0], options.steps)
    return {
        "same_race": is_same if _ENGINE in times else None,
        "contenders": {name: figures(times[name], times.get(_ENGINE)) for name in specs},
    }


def _step_tables(results: Sequence[Result]) -> list[Table]:
    columns = ("", "view", "karts", "step", "in engine", "ratio", "added", "to bare", "same race")
    return [
        Table(
            f"{group}: one step [µs], median (10..90%)",
            columns,
            [row for result in results if result["group"] == group for row in _step_rows(result)],
        )
        for group in dict.fromkeys(result["group"] for result in results)
    ]


def _step_rows(result: Result) -> list[tuple[str, ...]]:
    return [
        (
            name,
            result["view"],
            str(result["karts"]),
            spread(times["step"]),
            spread(times.get("engine")),
            spread(times.get("ratio"), 3),
            spread(times.get("overhead")),
            f"{times['to_bare']:.3f}" if "to_bare" in times else "-",
            {True: "yes", False: "NO", None: "-"}[result["same_race"]],
        )
        for name, times in result["contenders"].items()
    ]


STEPS = Section(
    "a step of the engine, of stkzoo in each view, and of pystk2-gymnasium",
    _step_jobs,
    _measure_steps,
    _step_tables,
    {
        "steps": 300,
        "karts": [1, 3, 10, 20],
        "track": ["lighthouse"],
        "view": list(VIEWS),
        "group": list(GROUPS),
        "cores": [1],
    },
    {"steps": 10, "karts": [3], "view": ["flattened"]},
)

# ---------------------------------------------------------------------- transport


def _transport_jobs(options: argparse.Namespace) -> list[Job]:
    return [
        {"view": view, "karts": karts, "cores": number or "all"}
        for number in options.cores
        for view in options.view
        for karts in options.karts
    ]


def _measure_transport(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    view, karts = job["view"], job["karts"]
    pinned = cores(0 if job["cores"] == "all" else job["cores"])
    specs = {
        name: Spec("stkzoo", "parallel", view, karts, karts, name == _THERE, pinned)
        for name in (_HERE, _THERE)
    }
    with contenders(specs) as started:
        times, is_same = race_together(started, options.track[0], options.steps)
    added, outside = [], []
    for here, there, engine_here, engine_there in zip(
        times[_HERE]["total"],
        times[_THERE]["total"],
        times[_HERE]["engine"],
        times[_THERE]["engine"],
        strict=True,
    ):
        added.append(1e6 * (there - here))
        outside.append(1e6 * ((there - engine_there) - (here - engine_here)))
    return {
        "same_race": is_same,
        "step": quantiles(added),
        "outside_engine": quantiles(outside),
    }


def _transport_tables(results: Sequence[Result]) -> list[Table]:
    rows = [
        (
            result["view"],
            str(result["karts"]),
            str(result["cores"]),
            spread(result["step"]),
            spread(result["outside_engine"]),
        )
        for result in results
    ]
    return [
        Table(
            "what the worker adds to a step [µs], median (10..90%)",
            ("view", "karts", "cores", "step", "outside the engine"),
            rows,
            "outside the engine: without the time inside Race.step, whose noise is larger",
        )
    ]


TRANSPORT = Section(
    "what the worker adds to a step, on one core and on all",
    _transport_jobs,
    _measure_transport,
    _transport_tables,
    {
        "steps": 300,
        "karts": [1, 3, 10, 20],
        "track": ["lighthouse"],
        "view": ["flattened"],
        "cores": [1, 0],
    },
    {"steps": 10, "karts": [2]},
)

# ---------------------------------------------------------------------- scaling

#: Number of karts on each of several tracks, and the track of several numbers of karts.
_TRACK_KARTS, _KARTS_TRACK = 3, "lighthouse"


def _scaling_jobs(options: argparse.Namespace) -> list[Job]:
    more = [{"part": "karts", "karts": karts, "track": _KARTS_TRACK} for karts in options.karts]
    return more + [
        {"part": "tracks", "karts": _TRACK_KARTS, "track": track} for track in options.track
    ]


def _measure_scaling(job: Job, options: argparse.Namespace) -> Mapping[str, Any]:
    karts, pinned = job["karts"], cores(options.cores[0])
    specs = {_ENGINE: Spec("bare", num_kart=karts, num_agents=karts, cores=pinned)}
    for view in options.view:
        for where, subprocess in (("in process", False), ("worker", True)):
            name = f"{view}, {where}"
            specs[name] = Spec("stkzoo", "parallel", view, karts, karts, subprocess, pinned)
    with contenders(specs) as started:
        times, is_same = race_together(started, job["track"], options.steps)
    return {
        "same_race": is_same,
        "contenders": {name: figures(times[name], times[_ENGINE]) for name in specs},
    }


def _scaling_tables(results: Sequence[Result]) -> list[Table]:
    columns = ("", "karts", "track", "in engine", "added", "engine's share", "to bare")
    titles = {"karts": "more karts", "tracks": "other tracks"}
    return [
        Table(f"{titles[part]}: one step [µs], median (10..90%)", columns, rows)
        for part in titles
        if (rows := [row for r in results if r["part"] == part for row in _scaling_rows(r)])
    ]


def _scaling_rows(result: Result) -> list[tuple[str, ...]]:
    return [
        (
            name,
            str(result["karts"]),
            result["track"],
            spread(times.get("engine")),
            spread(times.get("overhead")),
            f"{100 / times['ratio']['median']:.0f}%" if "ratio" in times else "-",
            f"{times['to_bare']:.3f}",
        )
        for name, times in result["contenders"].items()
        if name != _ENGINE
    ]


SCALING = Section(
    "a step with 1 to 100 karts, and on all tracks",
    _scaling_jobs,
    _measure_scaling,
    _scaling_tables,
    {
        "steps": 100,
        "karts": [1, 2, 3, 5, 10, 20, 50, 100],
        "track": list(SPLITS["all"]),
        "view": ["full", "flattened"],
        "cores": [1],
    },
    {"steps": 10, "karts": [2], "track": ["olivermath"], "view": ["flattened"]},
)
