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

from stkzoo._reading import read_json, read_text, reading
from stkzoo._schema import plain_text
from stkzoo.drivers.driver import GAME_AI
from stkzoo.errors import StkzooError, shortened
from stkzoo.evaluation.batch.agents import NAME_MARK
from stkzoo.evaluation.batch.order import REPLAYS, RaceOrder, replay_file
from stkzoo.evaluation.batch.run import RunOptions, run_orders
from stkzoo.evaluation.benchmark.races import RaceOutcome, direction_name
from stkzoo.evaluation.benchmark.result import race_outcomes
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay import Replay, load_replay, other_versions, play_replay
from stkzoo.race.replay.file import controls_of
from stkzoo.race.result import AgentResult, RaceResult
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
#: Fields of a replay that are also settings of the race.
_SETTINGS = ("track", "reverse", "mode", "kart", "laps", "difficulty", "max_paths", "seed")
_STEP_SIZE = 0.1
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
        """Runs the race again in a worker process.

        Args:
            folder: folder of the entry.

        Returns:
            The result of the new race.

        Raises:
            StkzooError: the replay is of another race, or differs from the new race.
        """
        replay = load_replay(replay_file(folder, self.number))
        self._check_facts(replay)
        karts = tuple(self.wait_for or ())
        live = {n: text for n, text in enumerate(self.drivers) if n not in karts}
        watch = _RaceWatch(replay, karts)
        playback = play_replay(replay, listeners=[watch], live=live)
        if playback.first_difference is not None:
            others = other_versions(replay)
            raise EntryRefused(
                f"step {playback.first_difference} differs from the recording"
                + (f"; other versions here: {others}" if others else "")
            )
        if playback.result_differences:
            raise EntryRefused(f"step {replay.steps}: {'; '.join(playback.result_differences)}")
        if replay_digest(folder, self.number) != self.replay:
            raise EntryRefused(f"the replay is not the one of {ENTRY_FILE} (SHA-256)")
        if watch.other_controls:
            raise EntryRefused(watch.other_controls)
        recorded, measured = replay.result, playback.measured
        assert recorded is not None  # noqa: S101 - the replay is not partial
        agents = [f"kart_{number}" for number in karts]
        _refuse_others(
            {
                "kart_types": (replay.kart_types, watch.kart_types),
                "names of the drivers": (
                    [agent.name for agent in replay.agents],
                    [row.driver for row in _rows(measured)],
                ),
                **_claims(recorded, measured, agents),
            }
        )
        self._check_end(replay, recorded, measured, watch.last_finish)
        return _with_failures(measured, recorded, agents)

    def _check_end(
        self, replay: Replay, recorded: RaceResult, measured: RaceResult, last: int | None
    ) -> None:
        """Checks that a race ended when and as the rules say.

        Args:
            replay: the race.
            recorded: its result.
            measured: result of the new race.
            last: step in which the last kart of the agent finished; ``None`` without one.
        """
        if last not in (None, replay.steps):
            raise EntryRefused(f"step {last} ends the race, and the recording has {replay.steps}")
        karts = {f"kart_{number}" for number in self.wait_for or ()}
        expected = _expected_status(recorded, measured, karts, self.settings.max_steps or math.inf)
        for name, actual in (("status", replay.status), ("status of the result", recorded.status)):
            if actual != expected:
                raise EntryRefused(
                    f"step {replay.steps}: {name} is {shortened(actual)}, expected {expected!r}"
                )

    def _check_facts(self, replay: Replay) -> None:
        """Checks that a replay is of this race."""
        facts = {name: (getattr(replay, name), getattr(self.settings, name)) for name in _SETTINGS}
        count, karts = len(self.drivers), self.wait_for or ()
        drivers = [_source_and_label(text) for text in self.drivers]
        sources = [source for source, _ in drivers]
        facts |= {
            "step_size": (replay.step_size, _STEP_SIZE),
            "num_tracks": (replay.num_tracks, 1),
            "start_positions": (replay.start_positions, tuple(range(1, count + 1))),
            "number of karts": (len(replay.agents), count),
            "sources of the drivers": ([agent.source for agent in replay.agents], sources),
            "names of the agent's karts": (
                [agent.name for n, agent in enumerate(replay.agents) if n in karts],
                [label for n, (_, label) in enumerate(drivers) if n in karts],
            ),
            "karts of the game's AI": (
                [n for n, agent in enumerate(replay.agents) if agent.is_game_ai],
                [n for n, source in enumerate(sources) if source in GAME_AI],
            ),
            "is_partial": (replay.is_partial, False),
            "is_too_long": (replay.steps > (self.settings.max_steps or 0), False),
        }
        _refuse_others(facts)


def _refuse_others(facts: Mapping[str, tuple[object, object]]) -> None:
    """Raises an error for the first fact that is not as expected.

    Args:
        facts: the actual and the expected value, by name.
    """
    for name, (actual, expected) in facts.items():
        if actual != expected:
            raise EntryRefused(
                f"step 0: {name} is {shortened(actual)}, expected {shortened(expected)}"
            )


def _source_and_label(driver: str) -> tuple[str, str]:
    source, mark, label = driver.rpartition(NAME_MARK)
    return (source, label) if mark else (driver, "")


def _rows(result: RaceResult | None) -> list[AgentResult]:
    """Returns the rows of a result in the order of the agents."""
    return sorted(result.agents, key=lambda row: (len(row.agent), row.agent)) if result else []


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


def _claims(
    recorded: RaceResult, measured: RaceResult, karts: Sequence[str]
) -> dict[str, tuple[object, object]]:
    """Returns facts of two results that playing a replay does not compare exactly, by name.

    The agent's failures and all decision times are left out: a replay cannot show them.

    Args:
        recorded: result in the replay.
        measured: result of the new race.
        karts: ids of the agent's karts.
    """
    pairs = [
        {
            "drivers and rescues of the result": [
                (row.agent, row.driver, row.source, row.rescues) for row in result.agents
            ],
            "finish times of the result": [row.finish_time for row in result.agents],
            "status and failures of the rivals": [
                (row.status, row.num_errors, row.num_clipped, row.errors)
                for row in result.agents
                if row.agent not in karts
            ],
            "finished karts of the result": [
                row.agent for row in result.agents if row.status == "finished"
            ],
            "race_time of the result": result.race_time,
        }
        for result in (recorded, measured)
    ]
    return {name: (pairs[0][name], pairs[1][name]) for name in pairs[0]}


def _with_failures(measured: RaceResult, recorded: RaceResult, karts: Sequence[str]) -> RaceResult:
    """Returns a result with the recorded numbers of the agent's failures.

    Args:
        measured: result of the new race.
        recorded: result in the replay.
        karts: ids of the agent's karts.
    """
    failures = {row.agent: row.num_errors for row in recorded.agents if row.agent in karts}
    rows = (replace(row, num_errors=failures.get(row.agent, 0)) for row in measured.agents)
    return replace(measured, agents=tuple(rows))


class _RaceWatch(RaceListener):
    """Finds when the agent's karts finish, and whether all karts are driven as recorded.

    Args:
        replay: the recorded race.
        karts: numbers of the agent's karts.

    Attributes:
        kart_types: model of each kart, in grid order.
        last_finish: step in which the last of the agent's karts finishes; ``None`` if some have
            not finished.
        other_controls: the first step in which a recorded control differs; empty without one.
    """

    def __init__(self, replay: Replay, karts: Sequence[int]) -> None:
        self._replay = replay
        self._own = {f"kart_{number}" for number in karts}
        self.kart_types: tuple[str, ...] = ()
        self.last_finish: int | None = None
        self.other_controls = ""

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.kart_types = race.race_info.kart_types

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        if self.last_finish is None and not self._own & set(race.env.agents):
            self.last_finish = race.steps
        for number, recorded in enumerate(self._replay.controls[race.steps - 1].tolist()):
            action = race.actions.get(f"kart_{number}")
            row = controls_of(action) if action is not None else [0.0] * len(recorded)
            if not self.other_controls and row != recorded:
                self.other_controls = f"step {race.steps} has other controls of kart_{number}"


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
    plan, problems = entry.plan, []
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
    for entry_field in fields(plan):
        actual, needed = getattr(plan, entry_field.name), getattr(expected, entry_field.name)
        if actual != needed:
            problems.append(f"{entry_field.name} of the plan is not that of {task.name} in {SUITE}")
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
        if (difference := _difference(_plain(recorded), _plain(race)))
    ]
    _refuse(problems)
    fresh = json.loads(replace(entry, races=measured).to_json())
    if difference := _difference(claimed, fresh):
        _refuse([f"{ENTRY_FILE}: {difference}"])


def _plain(race: RaceOutcome) -> Any:
    return json.loads(json.dumps(asdict(race)))


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
