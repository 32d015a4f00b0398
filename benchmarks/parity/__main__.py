"""Runs the same races in stkzoo and in pystk2-gymnasium 0.10.0 and compares every step.

    python -m benchmarks.parity
    python -m benchmarks.parity --track lighthouse --steps 60
    python -m benchmarks.parity --show D31      # also list the intended differences with this code

stkzoo draws each race (seed, grid positions), and both run it with the same actions. Keys, types,
shapes, values, rewards, ends and infos are compared at every step.
``benchmarks.parity.intended.INTENDED`` lists the intended differences; with any other difference,
the command returns 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import gymnasium

from benchmarks.common import RESULTS, Result, Table, measure_all, parser, positive
from benchmarks.parity.compare import TOLERANCE, compare
from benchmarks.parity.intended import INTENDED, RaceContext
from benchmarks.parity.reference import (
    Job,
    Moment,
    Recording,
    ReferenceProcess,
    flatten,
    inner_spaces,
)
from stkzoo import AgentSpec
from stkzoo.engine.assets import find_assets
from stkzoo.tracks import SPLITS

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

_NUM_KART = 4


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


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = _parser().parse_args(arguments)
    jobs = [*map(asdict, jobs_for(options.ids, options.track, options.steps, options.modes))]
    intended = [entry for entry in INTENDED if entry.code not in options.show]
    with ReferenceProcess(find_assets().root) as reference:

        def measure(job: Mapping[str, Any]) -> Mapping[str, Any]:
            ours, theirs, context = record_race(Job(**job), reference)
            return vars(compare(ours, theirs, context, intended))

        results = measure_all(options.output, options, jobs, measure, _tables)
    _print_legend(results)
    for result in results:
        for text in result["undocumented"]:
            print(f"undocumented: {result['env_id']} {result['track']}: {text}")
    return int(any(result["undocumented"] for result in results))


def _parser() -> argparse.ArgumentParser:
    words = parser("parity", __doc__)
    words.add_argument("--ids", nargs="+", choices=ENV_IDS, default=ENV_IDS, metavar="ID")
    words.add_argument("--track", nargs="+", choices=SPLITS["all"], default=TRACKS, metavar="NAME")
    words.add_argument("--modes", nargs="+", choices=MODES, default=MODES, metavar="MODE")
    words.add_argument("--steps", type=positive, default=300, help="of each race (default: 300)")
    words.add_argument("--show", nargs="+", default=[], metavar="CODE", help="such as D31")
    words.add_argument("--output", type=Path, default=RESULTS / "parity.json", help="JSON file")
    return words


def _tables(results: Sequence[Result]) -> list[Table]:
    columns = (
        *("id", "track", "agents driven by", "mode", "steps", "largest error"),
        *("intended differences", "others"),
    )
    rows = [
        (
            result["env_id"].removeprefix("supertuxkart/"),
            result["track"],
            " ".join(("action", "AI")[is_ai] for is_ai in result["use_ai"]),
            MODES[result["use_subprocess"]],
            str(result["steps"]),
            f"{result['max_error']:.1e}",
            " ".join(sorted(result["intended"])),
            str(len(result["undocumented"])),
        )
        for result in results
    ]
    return [Table("stkzoo and pystk2-gymnasium 0.10.0, step by step", columns, rows)]


def _print_legend(results: Sequence[Result]) -> None:
    met = {code for result in results for code in result["intended"]}
    for entry in INTENDED:
        if entry.code in met:
            print(f"  {entry.code}: {entry.why}")
    worst = max(results, key=lambda result: result["max_error"])
    print(f"Largest error {worst['max_error']:.1e} ({worst['worst']}), allowed {TOLERANCE:.0e}.")


if __name__ == "__main__":
    sys.exit(main())
