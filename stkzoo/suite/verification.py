"""Verification of entries: every race is run again, and every number is computed again."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._checks import shortened
from stkzoo._reading import read_json, read_text, reading
from stkzoo._schema import plain_text
from stkzoo._temporary import TemporaryFolder
from stkzoo.drivers.driver import GAME_AI, Driver
from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch.agents import NAME_MARK
from stkzoo.evaluation.batch.order import REPLAYS, RaceOrder, replay_file
from stkzoo.evaluation.batch.run import RunOptions, run_orders
from stkzoo.evaluation.benchmark.races import direction_name
from stkzoo.evaluation.benchmark.result import race_outcomes
from stkzoo.race.replay import (
    Replay,
    ReplayWriter,
    load_replay,
    other_versions,
    recorded_driver,
)
from stkzoo.race.result import RaceResult
from stkzoo.suite.entry import (
    ENTRY_FILE,
    Entry,
    EntryPlan,
    entry_orders,
    plan_entry,
    replay_digest,
)
from stkzoo.suite.tasks import SUITE, find_task

_MAX_SHOWN = 10
#: Allowed difference of numbers: bootstraps may round differently on another machine.
_TOLERANCE = 1e-9


class EntryRefused(StkzooError):
    """Raised when an entry is incomplete or one of its claims is false."""


@dataclass(frozen=True, slots=True)
class VerifyOrder(RaceOrder):
    """A recorded race to run again: the agent's karts repeat their controls, the others drive live.

    If the agent is the game's AI, its karts are live too.

    Attributes:
        replay: SHA-256 of the replay.
    """

    replay: str = ""

    @classmethod
    def of(cls, order: RaceOrder, replay: str) -> VerifyOrder:
        """Returns the order that repeats the race of another order.

        Args:
            order: the other order.
            replay: SHA-256 of its replay.
        """
        return cls(order.number, order.drivers, order.settings, order.wait_for or (), replay=replay)

    def run(self, folder: Path) -> RaceResult:
        """Runs and records the race again in a worker process, and compares both recordings.

        Args:
            folder: folder of the entry.

        Returns:
            The result of the new race, with the recorded numbers of the agent's failures.

        Raises:
            StkzooError: the replay is of another race, or differs from the new race.
        """
        recorded = load_replay(replay_file(folder, self.number))
        if len(recorded.agents) != len(self.drivers):
            raise EntryRefused(
                f"step 0: it has {len(recorded.agents)} karts, expected {len(self.drivers)}"
            )
        with TemporaryFolder("verify") as place:
            again = self._record(recorded, place.path / "again.stkz")
        _compare_steps(recorded, again)
        if replay_digest(folder, self.number) != self.replay:
            raise EntryRefused(f"the replay is not the one of {ENTRY_FILE} (SHA-256)")
        if recorded.result is None or again.result is None:
            raise EntryRefused(f"step {recorded.steps} does not end the race")
        return self._compare_ends(recorded, recorded.result, again.result)

    def _record(self, recorded: Replay, file: Path) -> Replay:
        """Runs the race again for at most as many steps as a recording has; returns its replay."""
        drivers: list[str | Driver] = [*self.drivers]
        for number in self.wait_for or ():
            source, _, label = self.drivers[number].rpartition(NAME_MARK)
            if source not in GAME_AI:
                driver = recorded_driver(label, recorded.controls[:, number])
                drivers[number] = replace(driver, source=source)
        steps = min(recorded.steps, self.settings.max_steps or recorded.steps)
        settings = replace(self.settings, max_steps=steps, action_timeout=None, time_budget=None)
        replace(self, settings=settings).race(drivers, [ReplayWriter(file)])
        return load_replay(file)

    def _compare_ends(self, replay: Replay, recorded: RaceResult, again: RaceResult) -> RaceResult:
        """Compares two results; returns the new one with the recorded failures and their effect.

        Args:
            replay: the recording.
            recorded: its result.
            again: result of the new race.
        """
        karts = {f"kart_{number}" for number in self.wait_for or ()}
        difference = _difference(_verifiable(recorded, karts), _verifiable(again, karts))
        if difference:
            raise EntryRefused(f"step {replay.steps}: {difference}")
        expected = _expected_status(recorded, again, karts, self.settings.max_steps or math.inf)
        for status in (replay.status, recorded.status):
            if status != expected:
                raise EntryRefused(
                    f"step {replay.steps}: status is {shortened(status)}, expected {expected!r}"
                )
        failures = {row.agent: row.num_errors for row in recorded.agents if row.agent in karts}
        rows = (replace(row, num_errors=failures.get(row.agent, 0)) for row in again.agents)
        return replace(again, status=expected, agents=tuple(rows))


def _compare_steps(recorded: Replay, again: Replay) -> None:
    """Compares a recording with that of the new race: its conditions, and each step."""
    heads = (replace(r, status="", result=None, versions={}) for r in (recorded, again))
    if difference := _difference(*(_plain({**head.to_dict(), "steps": 0}) for head in heads)):
        raise EntryRefused(f"step 0: {difference}")
    steps = again.steps
    states = np.argwhere(recorded.digests[: steps + 1] != again.digests)
    if len(states):
        versions = other_versions(recorded)
        raise EntryRefused(
            f"step {states[0][0]} differs from the recording"
            + (f"; other versions here: {versions}" if versions else "")
        )
    controls = np.argwhere(recorded.controls[:steps] != again.controls)
    if len(controls):
        step, kart, _ = controls[0]
        raise EntryRefused(f"step {step + 1} has other controls of kart_{kart}")
    if steps < recorded.steps:
        raise EntryRefused(f"step {steps} ends the race, and the recording has {recorded.steps}")


def _verifiable(result: RaceResult, karts: Collection[str]) -> Any:
    """Returns as JSON values what a new race shows of a result.

    These are all values except durations, versions, protections and the failures of the agent.

    Args:
        result: the result.
        karts: ids of the agent's karts.
    """
    rows = [replace(row, action_time=None) for row in result.agents]
    for number, row in enumerate(rows):
        if row.agent in karts:
            status = "finished" if row.status == "finished" else "racing"
            rows[number] = replace(row, status=status, num_errors=0, num_clipped=0, errors=())
    values = replace(result, status="racing", agents=tuple(rows), versions={}, wall_time=0.0)
    return _plain(replace(values, sandbox=None, protections=(), time_budget=None).to_dict())


def _expected_status(
    recorded: RaceResult, measured: RaceResult, karts: Collection[str], max_steps: float
) -> str:
    """Returns the status with which the rules end a race.

    Args:
        recorded: result in the replay; only it shows failures of the agent.
        measured: result of the new race.
        karts: ids of the agent's karts.
        max_steps: maximum number of steps.

    Raises:
        EntryRefused: the race ends too early.
    """
    driving = [  # before it has finished, only a failure ends a kart's race
        row.agent
        for row in recorded.agents
        if row.agent in karts
        and row.finish_time is None
        and not (row.status == "retired" and row.num_errors > 0)
    ]
    if driving and measured.steps < max_steps:
        raise EntryRefused(f"step {measured.steps} does not end the race of {driving[0]}")
    if driving:
        return "max_steps"
    if any(row.status == "racing" for row in measured.agents if row.agent not in karts):
        return "awaited_finished"
    is_any_finished = any(row.finish_time is not None for row in measured.agents)
    return "finished" if is_any_finished else "abandoned"


def verify_entry(
    folder: str | os.PathLike[str],
    **options: Any,
) -> Entry:
    """Runs all races of an entry again and compares every number, without the agent's code.

    The agent's karts repeat their recorded controls, unless the agent is the game's AI; the game's
    AI and the population drive again. All positions, rotations and velocities must be equal to the
    last bit.

    This verifies the races, their results and the names of their drivers. It does not verify who
    chose the controls, the failures and decision times of the agent, or what the entry says about
    itself and its software.

    Args:
        folder: folder of the entry, with ``entry.json`` and ``replays``.
        **options: ``jobs``, ``race_timeout`` and ``on_race``, as in
            :class:`~stkzoo.evaluation.RunOptions`.

    Returns:
        The entry.

    Raises:
        EntryRefused: the entry is incomplete, or a race or a number differs.
        ConfigError: there is no entry, its file is damaged, or an option is invalid.
    """
    settings = RunOptions(**options)
    place = Path(folder)
    text = _read(place / ENTRY_FILE)
    entry = Entry.from_json(text, str(place / ENTRY_FILE))
    _check_conditions(entry, place)
    pairs = zip(entry_orders(entry.plan), entry.replays, strict=True)
    orders = [VerifyOrder.of(order, digest) for order, digest in pairs]
    results: dict[int, RaceResult] = {}
    problems: dict[int, str] = {}
    with closing(run_orders(orders, place, settings, RaceResult)) as outcomes:
        for order, result, error in outcomes:
            if result is None:
                problems[order.number] = f"{_name(order)}: {error}"
            else:
                results[order.number] = result
    _refuse([problems[number] for number in sorted(problems)])
    _compare(entry, read_json(text, dict[str, Any], Entry.max_bytes), results)
    return entry


def _read(file: Path) -> str:
    with reading(f"{file} is not an entry", Entry.origin):
        return read_text(file, Entry.max_bytes)


def _refuse(problems: Sequence[str]) -> None:
    """Raises an error with the first problems, if there are any."""
    more = [f"... and {len(problems) - _MAX_SHOWN} more"] if len(problems) > _MAX_SHOWN else []
    if problems:
        raise EntryRefused("\n".join(["the entry is refused:", *problems[:_MAX_SHOWN], *more]))


def _name(order: RaceOrder) -> str:
    direction = direction_name(order.settings.reverse)
    return f"race {order.number} ({order.settings.track} {direction})"


def _check_conditions(entry: Entry, folder: Path) -> None:
    """Checks that an entry has all races of its task, under the conditions of the suite."""
    plan = entry.plan
    task = find_task(plan.task)
    if plan.is_on_training_tracks:
        remedy = f"an entry needs `stkzoo suite evaluate {task.name} AGENT` without --split train"
        _refuse([f"it is an evaluation on the training tracks; {remedy}"])
    expected = plan_entry(task, "random")
    conditions = {name: getattr(expected.settings, name) for name in EntryPlan.decided}
    expected = replace(
        expected,
        agents=plan.agents,
        about=plan.about,
        versions=plan.versions,
        settings=replace(plan.settings, **conditions),
    )
    problems = [
        f"{entry_field.name} of the plan is not that of {task.name} in {SUITE}"
        for entry_field in fields(plan)
        if getattr(plan, entry_field.name) != getattr(expected, entry_field.name)
    ]
    if not entry.is_complete:
        problems.append(f"it has {len(entry.races)} of {len(expected.races())} races")
    names = {replay_file(folder, race.number).name for race in expected.races()}
    if strange := names ^ {file.name for file in (folder / REPLAYS).glob("*")}:
        shown = plain_text(", ".join(sorted(strange)[:_MAX_SHOWN]))
        problems.append(f"{REPLAYS} does not have exactly one replay per race; see {shown}")
    _refuse(problems)


def _compare(entry: Entry, claimed: dict[str, Any], results: Mapping[int, RaceResult]) -> None:
    """Compares all numbers of an entry with those of the races that were run again."""
    plan = entry.plan
    measured = race_outcomes(plan, results)
    problems = [
        f"race {race.number} ({race.track} {direction_name(race.reverse)}), step "
        f"{results[race.number].steps}: {difference}"
        for race, recorded in zip(measured, entry.races, strict=True)
        if (difference := _difference(_plain(asdict(recorded)), _plain(asdict(race))))
    ]
    _refuse(problems)
    fresh = json.loads(replace(entry, races=measured).to_json())
    if claimed["plan"].pop("ai_races", None) is not None:
        # An older entry: its intervals over tracks count the errors of the AI's times twice.
        for group in (*claimed["groups"], *fresh["groups"]):
            group.pop("clustered", None)
    if difference := _difference(claimed, fresh):
        _refuse([f"{ENTRY_FILE}: {difference}"])


def _plain(values: dict[str, Any]) -> Any:
    """Returns values as JSON has them, with lists instead of tuples."""
    return json.loads(json.dumps(values))


def _difference(claimed: Any, actual: Any, path: str = "") -> str:
    """Describes the first difference between two JSON values; an empty text if there is none."""
    if isinstance(claimed, dict) and isinstance(actual, dict):
        for name in sorted({*claimed, *actual}):
            inner = f"{path}.{name}" if path else name
            if name not in actual:
                return f"{inner} is not a field of an entry"
            if name not in claimed:
                return f"{inner} is missing"
            if text := _difference(claimed[name], actual[name], inner):
                return text
        return ""
    if isinstance(claimed, list) and isinstance(actual, list) and len(claimed) == len(actual):
        pairs = enumerate(zip(claimed, actual, strict=True))
        return next((t for n, pair in pairs if (t := _difference(*pair, f"{path}[{n}]"))), "")
    if type(claimed) is type(actual) is float:
        is_equal = math.isclose(claimed, actual, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
    else:
        is_equal = type(claimed) is type(actual) and claimed == actual
    return "" if is_equal else f"{path} is {shortened(claimed)}, and the races give {actual!r}"
