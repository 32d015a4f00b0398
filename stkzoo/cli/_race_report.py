"""Terminal output of races: a progress bar during a race, and tables of results."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from statistics import fmean
from typing import TYPE_CHECKING

from stkzoo.cli._console import Bars, counted, say, show_table
from stkzoo.config import NORMAL
from stkzoo.race import AgentResult, RaceListener, RaceProgress, RaceResult

if TYPE_CHECKING:
    from stkzoo.race.replay import Replay

_MAX_TRACE_LINES = 40
_RACE_COLUMNS = ("rank", "driver", "kart", "time [s]", "distance [m]", "reward", "think [ms]")
_SERIES_COLUMNS = ("driver", "kart", "wins", "rank", "finished", "time [s]", "reward", "errors")


class RaceBar(Bars, RaceListener):
    """A progress bar on stderr with the leader's distance and the speed of the simulation."""

    def __init__(self) -> None:
        super().__init__()
        self.disable |= not sys.stdout.isatty()
        self.begin("starting", 1.0)

    def started(self, _: RaceProgress) -> None:
        """Resets the clock for the speed of the simulation."""
        self._start = time.monotonic()

    def stepped(self, race: RaceProgress) -> None:
        """Updates the bar."""
        elapsed = max(time.monotonic() - self._start, 1e-3)
        leader = race.leader_distance
        self.update(
            self.task_ids[0],
            description="waiting for the others" if leader >= race.race_length else "the leader",
            total=race.race_length,
            completed=leader,
            text=f"{leader:4.0f} of {race.race_length:.0f} m, "
            f"{race.race_time / elapsed:3.0f} x real time",
        )


def described(race: RaceResult | Replay) -> str:
    """Returns the track of a race, its direction and its mode as text."""
    way = ", reversed" if race.reverse else ""
    mode = "" if race.mode == NORMAL else f", {race.mode.replace('_', ' ')}"
    return f"{race.track}{way}{mode}"


def show_race(result: RaceResult) -> None:
    """Prints the result of one race: its settings, the ranking, and failures of agents."""
    say(
        f"{described(result)}: {counted(result.laps, 'lap')}, {result.race_length:.0f} m, "
        f"difficulty {result.difficulty}, seed {result.seed}"
    )
    styles = map(_style_of, result.agents)
    show_table(_RACE_COLUMNS, map(_race_cells, result.agents), styles=styles)
    reason = "" if result.status == "finished" else f" ({result.status.replace('_', ' ')})"
    steps = f"{counted(result.steps, 'step')}, countdown included"
    say(f"Ended after {steps}{reason}; it took {result.wall_time:.1f} s.")
    for row in result.agents:
        show_errors(row)
        if row.num_clipped:
            clipped = counted(row.num_clipped, "action")
            say(f"\n{row.driver} ({row.agent}): {clipped} clipped to its space")


def _race_cells(row: AgentResult) -> Sequence[object]:
    failed = "failed" if row.status == "retired" else "not finished"
    time = failed if row.finish_time is None else row.finish_time
    think = 1000 * row.action_time.mean if row.action_time else None
    return (row.rank, row.driver, row.agent, time, row.distance, row.reward, think)


def show_series(results: Sequence[RaceResult]) -> None:
    """Prints the results of several races with the same drivers as one table."""
    tracks = ", ".join(dict.fromkeys(result.track for result in results))
    say(f"{len(results)} races, seeds {results[0].seed} to {results[-1].seed}: {tracks}")
    by_agent: dict[str, list[AgentResult]] = {}
    for result in results:
        for row in result.agents:
            by_agent.setdefault(row.agent, []).append(row)
    in_order = sorted(by_agent.values(), key=lambda rows: fmean(row.rank for row in rows))
    show_table(_SERIES_COLUMNS, map(_series_cells, in_order))
    for result in results:
        for row in result.agents:
            show_errors(row, f" in the race with seed {result.seed}")


def _series_cells(rows: Sequence[AgentResult]) -> Sequence[object]:
    times = [row.finish_time for row in rows if row.finish_time is not None]
    return (
        rows[0].driver,
        rows[0].agent,
        sum(row.rank == 1 for row in rows),
        fmean(row.rank for row in rows),
        f"{len(times)} of {len(rows)}",
        fmean(times) if times else None,
        fmean(row.reward for row in rows),
        sum(row.num_errors for row in rows),
    )


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
