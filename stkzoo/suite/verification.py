"""Verification of entries: every race is run again, and every number is computed again."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._checks import shortened
from stkzoo._reading import load_json
from stkzoo._schema import plain_text
from stkzoo._temporary import TemporaryFolder
from stkzoo.drivers.driver import Driver, find_driver
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.batch.agents import NAME_MARK, find_agents
from stkzoo.evaluation.batch.order import REPLAYS, RaceOrder, replay_file
from stkzoo.evaluation.batch.run import RunOptions, run_orders
from stkzoo.evaluation.benchmark.races import RaceOutcome, direction_name
from stkzoo.evaluation.benchmark.result import race_outcomes
from stkzoo.race.replay import (
    Replay,
    ReplayWriter,
    load_replay,
    other_versions,
    recorded_driver,
)
from stkzoo.race.result import RaceResult
from stkzoo.race.settings import RaceSettings
from stkzoo.suite.about import shipped_class
from stkzoo.suite.entry import (
    ENTRY_FILE,
    TEST,
    TRAIN,
    Entry,
    EntryPlan,
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
    """A recorded race to run again. The rivals drive live.

    Attributes:
        replay: SHA-256 of the replay.
        live: name or path of the driver of the agent's karts; empty if they repeat their controls.
    """

    replay: str = ""
    live: str = ""

    @classmethod
    def of(cls, order: RaceOrder, replay: str, live: str) -> VerifyOrder:
        """Returns the order that repeats the race of another order.

        Args:
            order: the other order.
            replay: SHA-256 of its replay.
            live: see the class.
        """
        settings = _safe(order.settings)
        if not live:
            settings = replace(settings, action_timeout=None, time_budget=None)
        awaited = order.wait_for or ()
        return cls(order.number, order.drivers, settings, awaited, replay=replay, live=live)

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

    def store(self, folder: Path, result: RaceResult) -> None:
        """Stores nothing: the entry stays as it is."""

    def _record(self, recorded: Replay, file: Path) -> Replay:
        """Runs the race again for at most as many steps as a recording has; returns its replay."""
        drivers: list[str | Driver] = [*self.drivers]
        for number in self.wait_for or ():
            source, _, label = self.drivers[number].rpartition(NAME_MARK)
            driver = (
                find_driver(self.live)
                if self.live
                else recorded_driver(label, recorded.controls[:, number])
            )
            drivers[number] = replace(driver, name=label, source=source)
        steps = min(recorded.steps, self.settings.max_steps or recorded.steps)
        settings = replace(self.settings, max_steps=steps)
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
        pair = (_verifiable(result, karts, is_live=bool(self.live)) for result in (recorded, again))
        difference = _difference(*pair)
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


def _safe(settings: RaceSettings) -> RaceSettings:
    """Returns an entry's settings, with limits for agents even if the entry has none."""
    default = RaceSettings()
    return replace(
        settings,
        inline=False,
        sandbox=default.sandbox,
        agent_memory=default.agent_memory,
        action_timeout=settings.action_timeout or default.action_timeout,
    )


def _compare_steps(recorded: Replay, again: Replay) -> None:
    """Compares a recording with that of the new race: its conditions, and each step."""
    heads = (replace(r, status="", result=None, versions={}) for r in (recorded, again))
    if difference := _difference(*(_plain({**head.to_dict(), "steps": 0}) for head in heads)):
        raise EntryRefused(f"step 0: {difference}")
    steps = again.steps
    states = np.argwhere(recorded.digests[: steps + 1] != again.digests)
    controls = np.argwhere(recorded.controls[:steps] != again.controls)
    versions = other_versions(recorded)
    hint = f"; other versions here: {versions}" if versions else ""
    if len(controls) and not (len(states) and states[0][0] <= controls[0][0]):
        step, kart, _ = controls[0]
        name = recorded.agents[kart].name
        raise EntryRefused(
            f"step {step + 1} has other controls of kart_{kart} than {name} chooses{hint}"
        )
    if len(states):
        raise EntryRefused(f"step {states[0][0]} differs from the recording{hint}")
    if steps < recorded.steps:
        raise EntryRefused(f"step {steps} ends the race, and the recording has {recorded.steps}")


def _verifiable(result: RaceResult, karts: Collection[str], *, is_live: bool) -> Any:
    """Returns as JSON values what a new race shows of a result.

    These are all values except durations, versions, protections and the failures of the agent: the
    texts of its errors, and also their number if it does not drive again.

    Args:
        result: the result.
        karts: ids of the agent's karts.
        is_live: whether the agent drives again.
    """
    rows = [replace(row, action_time=None) for row in result.agents]
    for number, row in enumerate(rows):
        if row.agent in karts and is_live:
            rows[number] = replace(row, errors=())
        elif row.agent in karts:
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
    *,
    agent: str | None = None,
    **options: Any,
) -> Entry:
    """Runs all races of an entry again and compares every number.

    The rivals drive again, and so does a driver that comes with stkzoo if the entry is of it. Other
    agents' karts repeat their recorded controls, unless ``agent`` is the agent itself. All
    positions, rotations and velocities must be equal to the last bit.

    This verifies the races and their results. It verifies that the agent drove only if it drives
    again (:func:`proof_of`), and nothing that the entry says about its agent and its software.

    Args:
        folder: folder of the entry, with ``entry.json`` and ``replays``.
        agent: the agent, as for :func:`evaluate`; it drives in the sandbox, with the seeds of the
            entry's races. ``None`` repeats its recorded controls.
        **options: ``jobs``, ``race_timeout`` and ``on_race``, as in
            :class:`~stkzoo.evaluation.RunOptions`.

    Returns:
        The entry.

    Raises:
        EntryRefused: the entry is incomplete, or a race or a number differs.
        ConfigError: there is no entry, its file is damaged, the agent does not exist, or an option
            is invalid.
    """
    settings = RunOptions(**options)
    place = Path(folder)
    entry = Entry.load(place / ENTRY_FILE)
    if entry.plan.is_on_training_tracks:
        remedy = f"an entry needs `stkzoo suite evaluate {entry.plan.task} AGENT` without --split"
        _refuse(place, [f"it is an evaluation on the training tracks; {remedy} train"])
    check_conditions(entry, place)
    pairs = zip(entry.plan.orders(), entry.replays, strict=True)
    live = _live_driver(entry.plan, agent)
    orders = [VerifyOrder.of(order, digest, live) for order, digest in pairs]
    results: dict[int, RaceResult] = {}
    errors = run_orders(orders, place, settings, results)
    _refuse(place, [f"{_name(orders[number])}: {errors[number]}" for number in sorted(errors)])
    _compare(entry, place, results)
    return entry


def _live_driver(plan: EntryPlan, agent: str | None) -> str:
    """Returns the driver that drives the agent's karts again; an empty text without one."""
    shipped = shipped_class(plan.agent.source) is not None
    if agent is None:
        return plan.agent.source if shipped else ""
    if shipped:
        raise ConfigError(
            f"{plan.agent.source!r} comes with stkzoo and drives again by itself; leave out the "
            "agent (--agent)"
        )
    return find_agents([agent], _safe(plan.settings))[0].source


def proof_of(entry: Entry, agent: str | None = None) -> str:
    """Returns what :func:`verify_entry` has proven about an entry, and what it has not.

    Args:
        entry: the verified entry.
        agent: as for :func:`verify_entry`.
    """
    source = entry.plan.agent.source
    driver = source if shipped_class(source) else agent
    if driver is None:
        return (
            f"Proven: the races took place. Not proven: that {entry.label} drove; with its files, "
            "`stkzoo suite verify ENTRY --agent AGENT` proves it."
        )
    return (
        f"Proven: {driver} drove in all races. Not proven: what the entry says about authors and "
        "training."
    )


def _refuse(folder: Path, problems: Sequence[str]) -> None:
    """Raises an error with the first problems of an entry, if there are any."""
    more = [f"... and {len(problems) - _MAX_SHOWN} more"] if len(problems) > _MAX_SHOWN else []
    if problems:
        raise EntryRefused(
            "\n".join([f"the entry {folder} is refused:", *problems[:_MAX_SHOWN], *more])
        )


def _name(order: RaceOrder) -> str:
    direction = direction_name(order.settings.reverse)
    return f"race {order.number} ({order.settings.track} {direction})"


def check_conditions(entry: Entry, folder: Path) -> None:
    """Checks that an entry has all races of its task, under the conditions of the suite.

    Args:
        entry: the entry, or an evaluation on the training tracks.
        folder: its folder.

    Raises:
        EntryRefused: races or replays are missing, or the conditions are others.
    """
    plan = entry.plan
    task = find_task(plan.task)
    split = TRAIN if plan.is_on_training_tracks else TEST
    expected = plan_entry(task, "random", split=split, fresh=plan.fresh)
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
    _refuse(folder, problems)


def check_recordings(entry: Entry, folder: Path) -> tuple[RaceResult, ...]:
    """Checks that an entry has the replays of all its races, and follows from their results.

    This runs no race: it does not verify that the races took place.

    Args:
        entry: the entry, or an evaluation on the training tracks.
        folder: its folder.

    Returns:
        The result of each race.

    Raises:
        EntryRefused: it is incomplete, or a replay or a number is another one.
        ReplayError: a replay is damaged.
    """
    check_conditions(entry, folder)
    results: dict[int, RaceResult] = {}
    problems = []
    for order, digest in zip(entry.plan.orders(), entry.replays, strict=True):
        result = load_replay(replay_file(folder, order.number)).result
        if replay_digest(folder, order.number) != digest:
            problems.append(f"{_name(order)}: the replay is not the one of {ENTRY_FILE} (SHA-256)")
        elif result is None or _race_of(result) != _race_of(order.settings):
            problems.append(f"{_name(order)}: the replay is of another race")
        else:
            results[order.number] = result
    _refuse(folder, problems)
    _compare_races(entry, folder, results)
    return tuple(results.values())


def _race_of(facts: RaceResult | RaceSettings) -> tuple[object, ...]:
    return facts.track, facts.reverse, facts.seed, facts.difficulty, facts.laps


def _compare(entry: Entry, folder: Path, results: Mapping[int, RaceResult]) -> None:
    """Compares all numbers of an entry with those of the races that were run again."""
    measured = replace(entry, races=_compare_races(entry, folder, results))
    claimed = load_json(folder / ENTRY_FILE, dict[str, Any], Entry.max_bytes)
    if difference := _difference(claimed, json.loads(measured.to_json())):
        _refuse(folder, [f"{ENTRY_FILE}: {difference}"])


def _compare_races(
    entry: Entry, folder: Path, results: Mapping[int, RaceResult]
) -> tuple[RaceOutcome, ...]:
    """Compares the races of an entry with their results; returns them as the results give them."""
    measured = race_outcomes(entry.plan, results)
    problems = [
        f"race {race.number} ({race.track} {direction_name(race.reverse)}), step "
        f"{results[race.number].steps}: {difference}"
        for race, recorded in zip(measured, entry.races, strict=True)
        if (difference := _difference(_plain(asdict(recorded)), _plain(asdict(race))))
    ]
    _refuse(folder, problems)
    return measured


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
