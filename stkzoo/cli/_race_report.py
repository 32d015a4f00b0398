"""Terminal output of races: a progress bar during a race, and tables of results."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from rich.progress import BarColumn, TextColumn

from stkzoo.cli._console import make_bars, say, show_table
from stkzoo.config import NORMAL
from stkzoo.errors import AgentError
from stkzoo.race import AgentResult, RaceListener, RaceProgress, RaceResult

if TYPE_CHECKING:
    from typing_extensions import Self  # a part of gymnasium

    from stkzoo.race.replay import Replay

_ENDINGS = {
    "finished": "",
    "awaited_finished": "all awaited karts had finished",
    "karts_finished": "as many karts had finished as --karts-finished asks for",
    "max_steps_after_first": "--max-steps-after-first had passed since the first finish",
    "max_steps": "cut short by --max-steps",
    "time_limit": "time limit: the others had not finished",
    "abandoned": "all drivers had failed",
    "interrupted": "interrupted: this is how far it has come",
}
_MAX_TRACE_LINES = 40
_TEXT_COLUMNS = ("driver", "kart")


class LoadCheck(RaceListener):
    """A race listener that ends a race before its first step if an agent could not be loaded."""

    def started(self, race: RaceProgress) -> None:
        """Checks the agents.

        Raises:
            AgentError: agents could not be loaded; the error describes all of them.
        """
        failed = [(agent, errors[0]) for agent, errors in race.failures.items() if errors]
        if failed:
            first, *others = (
                (f"{race.names[agent]} ({agent}) could not be loaded: {e.message}", e.trace)
                for agent, e in failed
            )
            traces = [first[1], *(f"\n{message}\n{trace}" for message, trace in others)]
            raise AgentError(first[0], failed[0][0], "\n".join(traces))


class RaceBar(RaceListener):
    """A progress bar on stderr with the leader's distance and the speed of the simulation."""

    def __init__(self) -> None:
        self._bars = make_bars(
            TextColumn("{task.description:<19}"), BarColumn(), TextColumn("{task.fields[way]}")
        )
        self._bars.disable |= not sys.stdout.isatty()
        self._task = self._bars.add_task("starting", total=1.0, way="")
        self._begin = time.monotonic()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._bars.stop()

    def started(self, _: RaceProgress) -> None:
        """Resets the clock for the speed of the simulation."""
        self._begin = time.monotonic()

    def stepped(self, race: RaceProgress) -> None:
        """Updates the bar."""
        elapsed = max(time.monotonic() - self._begin, 1e-3)
        leader = race.leader_distance
        is_won = leader >= race.race_length
        self._bars.update(
            self._task,
            description="waiting for the others" if is_won else "the leader",
            total=race.race_length,
            completed=leader,
            way=f"{leader:4.0f} of {race.race_length:.0f} m, "
            f"{race.race_time / elapsed:3.0f} x real time",
        )


def described(race: RaceResult | Replay) -> str:
    """Returns the track of a race, its direction and its mode as text."""
    way = ", reversed" if race.reverse else ""
    mode = "" if race.mode == NORMAL else f", {race.mode.replace('_', ' ')}"
    return f"{race.track}{way}{mode}"


def show_race(result: RaceResult) -> None:
    """Prints the result of one race: its settings, the ranking, and failures of agents."""
    laps = "1 lap" if result.laps == 1 else f"{result.laps} laps"
    way = described(result)
    say(
        f"{way}: {laps}, {result.race_length:.0f} m, "
        f"AI difficulty {result.difficulty}, seed {result.seed}"
    )
    columns = ("rank", "driver", "kart", "time [s]", "distance [m]", "reward", "think [ms]")
    styles = map(_style_of, result.agents)
    show_table(columns, map(_race_cells, result.agents), left=_TEXT_COLUMNS, styles=styles)
    steps = "1 step" if result.steps == 1 else f"{result.steps} steps"
    reason = _ENDINGS.get(result.status, result.status)
    say(
        f"Ended after {steps}, in {result.race_time:.1f} s of game time"
        f"{f' ({reason})' if reason else ''}; it took {result.wall_time:.1f} s."
    )
    for row in result.agents:
        show_errors(row)
        if row.num_clipped:
            say(
                f"\n{row.driver} ({row.agent}): {row.num_clipped} actions were clipped to its space"
            )


def _race_cells(row: AgentResult) -> Sequence[str]:
    think = f"{1000 * row.action_time.mean:.2f}" if row.action_time else "-"
    numbers = (_time_of(row), f"{row.distance:.0f}", f"{row.reward:.1f}", think)
    return (str(row.rank), row.driver, row.agent, *numbers)


def show_series(results: Sequence[RaceResult]) -> None:
    """Prints the results of several races with the same drivers as one table."""
    tracks = ", ".join(dict.fromkeys(result.track for result in results))
    say(f"{len(results)} races, seeds {results[0].seed} to {results[-1].seed}: {tracks}")
    numbers = ("wins", "mean rank", "finished", "mean time [s]", "reward", "errors")
    by_agent: dict[str, list[AgentResult]] = {}
    for result in results:
        for row in result.agents:
            by_agent.setdefault(row.agent, []).append(row)
    in_order = sorted(by_agent.values(), key=lambda rows: fmean(row.rank for row in rows))
    show_table((*_TEXT_COLUMNS, *numbers), map(_series_cells, in_order), left=_TEXT_COLUMNS)
    for result in results:
        for row in result.agents:
            show_errors(row, f" in the race with seed {result.seed}")


def _series_cells(rows: Sequence[AgentResult]) -> Sequence[str]:
    times = [row.finish_time for row in rows if row.finish_time is not None]
    return (
        rows[0].driver,
        rows[0].agent,
        str(sum(row.rank == 1 for row in rows)),
        f"{fmean(row.rank for row in rows):.2f}",
        f"{len(times)} of {len(rows)}",
        f"{fmean(times):.2f}" if times else "-",
        f"{fmean(row.reward for row in rows):.1f}",
        str(sum(row.num_errors for row in rows)),
    )


def _time_of(row: AgentResult) -> str:
    if row.finish_time is not None:
        return f"{row.finish_time:.2f}"
    return "failed" if row.status == "retired" else "not finished"


def _style_of(row: AgentResult) -> str | None:
    if row.num_errors:
        return "red"
    return "bold green" if row.rank == 1 else None


def show_errors(row: AgentResult, where: str = "") -> None:
    """Prints an agent's first failure and its number of failures.

    Args:
        row: result of the agent.
        where: name of the race, if there are several.
    """
    if not row.errors:
        return
    first = row.errors[0]
    when = "before the start" if first.kind == "start" else f"at step {first.step}"
    more = f" (the first of {row.num_errors} errors)" if row.num_errors > 1 else ""
    text = f"\n{row.driver} ({row.agent}) failed {when}{where}{more}: {first.message}"
    trace = "\n".join(f"  {line}" for line in first.trace.splitlines()[-_MAX_TRACE_LINES:])
    say(f"{text}\n{trace}".rstrip("\n"))
