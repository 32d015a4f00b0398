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

import json
from dataclasses import asdict, dataclass
from typing import Any

from stkzoo._arguments import options_of, positional
from stkzoo.cli._console import say
from stkzoo.cli._process import AGENT_FAILED
from stkzoo.evaluation import AgentReport, check_agent
from stkzoo.race import RaceSettings

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
    report = check_agent(
        arguments.agent,
        track=arguments.track,
        max_steps=arguments.max_steps,
        seed=arguments.seed,
        **arguments.settings,
    )
    if arguments.json:
        print(json.dumps(asdict(report), indent=2))
    else:
        _show(report, arguments.track, arguments.settings)
    return 0 if report.passed else AGENT_FAILED


def _show(report: AgentReport, track: str, limits: dict[str, Any]) -> None:
    steps = "1 step" if report.steps == 1 else f"{report.steps} steps"
    say(f"{report.name}: {steps}, {report.distance:.0f} m on {track}")
    if report.load_time is not None:
        say(f"  loading   {report.load_time:.1f} s (limit {limits['start_timeout']:g} s)")
    if report.thinking_time is not None:
        times = report.thinking_time
        limit = f"{limits['action_timeout']:g} s" if limits["action_timeout"] else "none"
        say(
            f"  thinking  mean {1000 * times.mean:.1f} ms, p99 {1000 * times.p99:.1f} ms, "
            f"max {1000 * times.max:.1f} ms (limit {limit})"
        )
    if report.memory is not None:
        limit = f"{limits['agent_memory']} MB" if limits["agent_memory"] else "none"
        say(f"  memory    {report.memory:.0f} MB (limit {limit})")
    if report.num_clipped:
        say(f"  actions   {report.num_clipped} were outside the action space and were clipped")
    if report.passed:
        say("PASS: a tournament would accept this agent.")
        return
    say(f"FAIL: {report.reason}")
    for line in report.trace.splitlines():
        say(f"  {line}")
