"""Check an agent before you submit it.

Loads an agent, lets it drive for a few seconds in its own process, and shows its times and
memory. The last line shows whether a tournament would accept it.

Examples:
  stkzoo check my_agent          a folder
  stkzoo check my_agent.zip      the file that you submit
  stkzoo check my_agent --json   JSON output for programs

exit codes:
  0 the agent passed, 1 the check could not be run, 2 invalid command line, 3
  the agent failed, 130 interrupted
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from stkzoo._arguments import options_of, positional
from stkzoo.cli._console import Bars, counted, say, show, show_table
from stkzoo.cli._process import AGENT_FAILED
from stkzoo.evaluation import AgentReport, check_agent
from stkzoo.race import RaceListener, RaceProgress, RaceSettings

_SETTINGS = ("show_output", "action_timeout", "start_timeout", "agent_memory", "sandbox")


@dataclass
class CheckArguments:
    """Arguments of ``stkzoo check``.

    Attributes:
        agent: a folder, a zip, a Python file, or the name of a module
        track: the track to drive
        max_steps: number of steps to drive
        seed: seed of all random choices
        json: write JSON instead of text
    """

    agent: str = positional(metavar="AGENT")
    track: str = "lighthouse"
    max_steps: int = 50
    seed: int = 0
    json: bool = False
    settings: dict[str, Any] = options_of(RaceSettings, only=_SETTINGS, group="agent")


def run(arguments: CheckArguments) -> int:
    """Checks the agent. Returns 3 if a tournament would not accept it."""
    settings = {**arguments.settings, "track": arguments.track, "seed": arguments.seed}
    with _CheckBar() as bar:
        steps = arguments.max_steps
        bar.begin("checking the agent", steps)
        report = check_agent(arguments.agent, max_steps=steps, listeners=[bar], **settings)
    as_text = partial(_show, track=arguments.track, limits=arguments.settings)
    show(report, as_text, as_json=arguments.json)
    return 0 if report.passed else AGENT_FAILED


class _CheckBar(Bars, RaceListener):
    """A bar on stderr while the agent is loaded and drives; see :class:`Bars`."""

    def stepped(self, race: RaceProgress) -> None:
        """Shows the steps so far."""
        self.show(race.steps, counted(race.steps, "step"))


def _show(report: AgentReport, track: str, limits: dict[str, Any]) -> None:
    say(f"{report.name}: {counted(report.steps, 'step')}, {report.distance:.0f} m on {track}")
    times, limit = report.thinking_time, limits["action_timeout"]
    rows = [
        ("loading [s]", report.load_time, limits["start_timeout"]),
        ("mean decision [ms]", times and 1000 * times.mean, None),
        ("longest decision [ms]", times and 1000 * times.max, limit and 1000 * limit),
        ("memory [MB]", report.memory, limits["agent_memory"] or None),
        ("clipped actions", report.num_clipped, None),
    ]
    show_table(("", "measured", "limit"), rows)
    if report.passed:
        say("PASS: a tournament would accept this agent.")
        return
    say(f"FAIL: {report.reason}")
    for line in report.trace.splitlines():
        say(f"  {line}")
