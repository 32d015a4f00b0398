"""Training runs with made-up races: valid entries with recordings, in memory and in folders."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo.evaluation.batch.agents import NAME_MARK, BatchAgent
from stkzoo.evaluation.batch.order import RaceOrder, replay_file
from stkzoo.evaluation.benchmark.result import race_outcomes
from stkzoo.race.replay import Replay, ReplayAgent, save_replay
from stkzoo.race.result import AgentResult, RaceResult
from stkzoo.suite import About, Entry, EntryPlan, Evaluation, SuiteRun, plan_entry
from stkzoo.suite.entry import ENTRY_FILE, replay_digest

#: Returns the time ratio of a race, or whether a rival is beaten, from the race and the rival.
Value = Callable[[RaceOrder, int], float]


def plan_of(
    task: str, algorithm: str, seed: int, split: str = "test", fresh: str = "", **about: Any
) -> EntryPlan:
    """Returns the plan of an entry of a trained agent, or with other facts ``about`` it."""
    facts = {"agent_class": "learned", "kart_steps": 2_000_000, **about}
    return replace(
        plan_entry(task, "random", split=split, fresh=fresh),
        agents=(BatchAgent(f"{algorithm} {seed}", f"runs/{task}-{algorithm}-{seed}/agent"),),
        about=About(algorithm=algorithm, training_seed=seed, **facts),
    )


def results_of(plan: EntryPlan, value: Value) -> Iterator[RaceResult]:
    """Yields made-up results of all races of an entry.

    All karts of the agent finish together, after the rivals that they do not beat.
    """
    for order in plan.orders():
        karts = range(len(order.drivers))
        own = order.wait_for or ()
        is_behind = {kart: kart not in own and bool(value(order, kart)) for kart in karts}
        ranked = sorted(karts, key=lambda kart: (is_behind[kart], kart in own))
        reference = plan.reference_time(str(order.settings.track), order.settings.reverse)
        is_time = plan.task.startswith("solo")
        rows = []
        for rank, kart in enumerate(ranked, 1):
            source, _, name = order.drivers[kart].rpartition(NAME_MARK)
            time = value(order, kart) * reference if is_time else 30.0 + rank
            names = (f"kart_{kart}", name, source or name, "finished", kart + 1, rank)
            rows.append(AgentResult(*names, time, laps=1, distance=100.0, reward=0.0, rescues=0))
        settings = order.settings
        yield RaceResult(
            status="finished",
            track=str(settings.track),
            reverse=settings.reverse,
            laps=settings.laps,
            difficulty=settings.difficulty,
            seed=settings.seed,
            race_length=100.0,
            steps=1,
            race_time=0.1,
            agents=tuple(rows),
        )


def evaluation_of(plan: EntryPlan, value: Value, folder: Path | None = None) -> Evaluation:
    """Returns an evaluation with made-up results; writes it if there is a folder."""
    results = tuple(results_of(plan, value))
    races = race_outcomes(plan, dict(enumerate(results)))
    if folder is None:
        return Evaluation(Path(), Entry(plan, races, replays=("0" * 64,) * len(races)), results)
    for order, result in zip(plan.orders(), results, strict=True):
        for file in (replay_file(folder, order.number), order.file(folder)):
            file.parent.mkdir(parents=True, exist_ok=True)
        save_replay(replay_of(result), replay_file(folder, order.number))
        order.file(folder).write_text(result.to_json())
    entry = Entry(plan, races, replays=tuple(replay_digest(folder, r.number) for r in races))
    (folder / ENTRY_FILE).write_text(entry.to_json())
    return Evaluation(folder, entry, results)


def replay_of(result: RaceResult) -> Replay:
    """Returns a valid recording of one step that has a result."""
    rows = sorted(result.agents, key=lambda row: row.start_position)
    return Replay(
        track=result.track,
        reverse=result.reverse,
        laps=result.laps,
        difficulty=result.difficulty,
        max_paths=None,
        step_size=0.1,
        seed=result.seed,
        num_tracks=1,
        engine_seed=0,
        start_positions=tuple(range(1, len(rows) + 1)),
        kart_types=("tux",) * len(rows),
        agents=tuple(ReplayAgent(row.driver, row.source, False) for row in rows),
        controls=np.zeros((1, len(rows), 7), np.float32),
        digests=np.zeros((2, 8), np.uint8),
        status=result.status,
        result=result,
        versions={},
    )


def constant(share: float) -> Value:
    """Returns the value of a time ratio, or of a share of rivals that the agent beats."""

    def value(order: RaceOrder, kart: int) -> float:
        rivals = [n for n in range(len(order.drivers)) if n not in (order.wait_for or ())]
        return share if kart not in rivals else rivals.index(kart) < round(share * len(rivals))

    return value


def suite_run(
    task: str, algorithm: str, seed: int, value: Value, train: Value | None = None, **about: Any
) -> SuiteRun:
    """Returns a run with made-up races and no learning curve.

    Args:
        task: name of the task.
        algorithm: name of the algorithm.
        seed: seed of the run.
        value: see :data:`Value`, on the test tracks.
        train: the same on the training tracks; ``None`` for no evaluation there.
        **about: other facts about the agent, or ``fresh``.
    """
    test = evaluation_of(plan_of(task, algorithm, seed, **about), value)
    if train is None:
        return SuiteRun(test, None, None)
    return SuiteRun(
        test, evaluation_of(plan_of(task, algorithm, seed, "train", **about), train), None
    )


def write_run(
    folder: Path, task: str, algorithm: str, seed: int, value: Value, **about: Any
) -> Path:
    """Writes the folder of a run: an entry, an evaluation on the training tracks, and a log."""
    home = folder / f"{task}-{algorithm}-{seed}"
    for name, split in (("entry", "test"), ("entry-train", "train")):
        evaluation_of(plan_of(task, algorithm, seed, split, **about), value, home / name)
    with (home / "log.jsonl").open("w") as log:
        for number in range(1, 41):
            line = {"kart_steps": number * 50_000, "kart_steps_per_s": 1000.0, "entropy": 1.0}
            ended = {"return": 100 - 100 / number, "finished": 0.5, "position": 2.5}
            log.write(json.dumps(line | (ended if number > 1 else {})) + "\n")
    return home
