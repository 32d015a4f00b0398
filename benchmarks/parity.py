"""Runs the same races in stkzoo and in pystk2-gymnasium 0.10.0 and compares every step.

    python -m benchmarks.parity --steps 300

stkzoo draws each race (seed, grid positions), and both run it with the same actions. Keys, types,
shapes, values, rewards, ends and infos are compared at every step.
``benchmarks.parity_intended.INTENDED`` lists the intended differences; with any other difference,
the command returns 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import gymnasium
from rich.console import Console
from rich.progress import track as progress_bar
from rich.table import Table

from benchmarks.parity_compare import TOLERANCE, Comparison, compare
from benchmarks.parity_intended import INTENDED, RaceContext
from benchmarks.parity_reference import (
    Job,
    Moment,
    Recording,
    ReferenceProcess,
    flatten,
    inner_spaces,
)
from stkzoo import AgentSpec
from stkzoo._arguments import CommandParser
from stkzoo.engine.assets import find_assets

__all__ = [
    "ENV_IDS",
    "MODES",
    "TRACKS",
    "compare_race",
    "jobs_for",
    "main",
    "record_race",
    "reference_process",
]

ENV_IDS = (
    "supertuxkart/full-v0",
    "supertuxkart/simple-v0",
    "supertuxkart/flattened-v0",
    "supertuxkart/flattened_continuous_actions-v0",
    "supertuxkart/flattened_multidiscrete-v0",
    "supertuxkart/flattened_discrete-v0",
    "supertuxkart/multi-full-v0",
)
#: Where the reference runs the engine: in its own process, or in a subprocess (its default).
MODES = ("direct", "process")
#: Tracks to compare; the last three have forks.
TRACKS = ("lighthouse", "hacienda", "cocoa_temple", "olivermath", "stk_enterprise")

_RESULTS = Path(__file__).parent / "results" / "parity.json"
_NUM_KART = 4


def reference_process() -> ReferenceProcess:
    """Starts the reference with the game data that stkzoo uses."""
    return ReferenceProcess(find_assets().root)


def jobs_for(
    env_ids: Sequence[str] = ENV_IDS,
    tracks: Sequence[str] = TRACKS,
    steps: int = 300,
    modes: Sequence[str] = ("direct",),
) -> Iterator[Job]:
    """Yields all races: each id on each track, driven by actions and by the game's AI.

    Each race runs in each of ``modes``, which are some of :data:`MODES`.

    The multi-agent id has three races: agents only, two agents with an AI agent, and AI agents
    only. The AI agent starts in front of the others, because otherwise the reference assigns
    actions to the wrong karts (D01).
    """
    for env_id in env_ids:
        teams: list[tuple[bool, ...]] = [(False,), (True,)]
        if "multi-full" in env_id:
            teams = [(False, False, False), (True, False, False), (True, True, True)]
        for track in tracks:
            for use_ai in teams:
                for mode in modes:
                    is_process = mode == "process"
                    yield Job(env_id, track, steps, _NUM_KART, use_ai, use_subprocess=is_process)


def compare_race(job: Job, reference: ReferenceProcess) -> tuple[Job, Comparison]:
    """Runs a race on both sides; returns the job with the drawn values, and the comparison."""
    ours, theirs, context = record_race(job, reference)
    return context.job, compare(ours, theirs, context)


def record_race(job: Job, reference: ReferenceProcess) -> tuple[Recording, Recording, RaceContext]:
    """Runs a race on both sides; returns our recording, the reference's, and the context."""
    env = _make(job)
    try:
        first = env.reset(seed=_seed(job))
        race = env.unwrapped.core.race  # type: ignore[attr-defined]
        job = replace(job, engine_seed=race.seed, kart_indices=race.kart_indices)
        theirs = reference.run(job)
        ours, context = _record(env, job, first, theirs.actions)
    finally:
        env.close()
    return ours, theirs, context


def _seed(job: Job) -> int:
    return ENV_IDS.index(job.env_id) * 100 + sum(map(ord, job.track)) % 97


def _make(job: Job) -> gymnasium.Env[Any, Any]:
    is_mixed = job.is_multi and any(job.use_ai)
    specs = [
        AgentSpec(use_ai=is_ai, rank_start=place if is_mixed else None)
        for place, is_ai in enumerate(job.use_ai)
    ]
    agents: dict[str, Any] = {"agents": specs} if job.is_multi else {"agent": specs[0]}
    return gymnasium.make(
        job.env_id,
        disable_env_checker=True,
        max_episode_steps=job.steps,
        track=job.track,
        num_kart=job.num_kart,
        **agents,
    )


def _record(
    env: gymnasium.Env[Any, Any], job: Job, first: tuple[Any, Any], actions: Sequence[Any]
) -> tuple[Recording, RaceContext]:
    core = env.unwrapped.core  # type: ignore[attr-defined]
    karts = list(job.kart_indices)
    observation, info = first
    moments = [Moment(flatten(observation), 0.0, False, False, flatten(info))]
    nodes = [core.snapshot.karts["node"][karts].tolist()]
    finished = [[False] * len(karts)]
    for action in actions:
        finished.append(core.snapshot.karts["has_finished_race"][karts].astype(bool).tolist())
        observation, reward, terminated, truncated, info = env.step(action)
        ends = bool(terminated), bool(truncated)
        moments.append(Moment(flatten(observation), float(reward), *ends, flatten(info)))
        nodes.append(core.snapshot.karts["node"][karts].tolist())
        if any(ends):
            break
    recording = Recording(
        moments, inner_spaces(env.observation_space), inner_spaces(env.action_space)
    )
    return recording, RaceContext(job, core.track_map, nodes, finished)


# ------------------------------------------------------------------------- the command


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = _parser().parse_args(arguments)
    console = Console(width=None if sys.stdout.isatty() else 150)
    jobs = list(jobs_for(options.ids, options.tracks, options.steps, options.modes))
    results = []
    with reference_process() as reference:
        for job in progress_bar(jobs, "races in both", console=console):
            results.append(compare_race(job, reference))  # noqa: PERF401 - with progress
    console.print(_table(results))
    _print_legend(console, results)
    _save(options.output, results)
    undocumented = [(job, text) for job, result in results for text in result.undocumented]
    for job, text in undocumented:
        console.print(f"undocumented: {_title(job)}: {text}", soft_wrap=True, markup=False)
    return 1 if undocumented else 0


def _parser() -> argparse.ArgumentParser:
    parser = CommandParser(prog="python -m benchmarks.parity", description=__doc__)
    parser.add_argument("--ids", nargs="+", choices=ENV_IDS, default=ENV_IDS, metavar="ID")
    parser.add_argument("--track", dest="tracks", nargs="+", default=TRACKS, metavar="TRACK")
    parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES, metavar="MODE")
    parser.add_argument("--steps", type=int, default=300, help="steps per race (default 300)")
    parser.add_argument("--output", type=Path, default=_RESULTS, help="JSON file to write")
    return parser


def _title(job: Job) -> str:
    return f"{job.env_id} {job.track} {_drivers(job)} {_mode(job)}"


def _mode(job: Job) -> str:
    return MODES[job.use_subprocess]


def _drivers(job: Job) -> str:
    names = ("action", "AI")
    return " ".join(names[is_ai] for is_ai in job.use_ai)


def _table(results: Sequence[tuple[Job, Comparison]]) -> Table:
    table = Table(title="stkzoo and pystk2-gymnasium 0.10.0, step by step")
    for name in ("id", "track", "agents driven by", "mode"):
        table.add_column(name, no_wrap=True)
    for name in ("steps", "largest error"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("intended differences")
    table.add_column("others", justify="right")
    for job, result in results:
        table.add_row(
            job.env_id.removeprefix("supertuxkart/"),
            job.track,
            _drivers(job),
            _mode(job),
            str(result.steps),
            f"{result.max_error:.1e}",
            " ".join(sorted(result.intended)),
            f"[red]{len(result.undocumented)}[/]" if result.undocumented else "0",
        )
    return table


def _print_legend(console: Console, results: Sequence[tuple[Job, Comparison]]) -> None:
    met = {code for _, result in results for code in result.intended}
    for entry in INTENDED:
        if entry.code in met:
            console.print(f"  [bold]{entry.code}[/]: {entry.why}", highlight=False)
    worst = max((result for _, result in results), key=lambda result: result.max_error)
    console.print(f"Largest error {worst.max_error:.1e} ({worst.worst}), allowed {TOLERANCE:.0e}.")


def _save(path: Path, results: Sequence[tuple[Job, Comparison]]) -> None:
    rows = [{**asdict(job), **vars(result)} for job, result in results]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"tolerance": TOLERANCE, "races": rows}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
