"""Measures the cost of the sandbox for the start of an agent and for a decision.

    python -m benchmarks.sandbox

Starts an agent several times with and without the sandbox, in turn, and requests actions. Prints
the medians.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from stkzoo._arguments import CommandParser
from stkzoo.drivers import sandbox
from stkzoo.drivers.driver import find_driver
from stkzoo.drivers.instances import DriverLimits, DriverRequest
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space

_AGENT = Path(__file__).parents[1] / "tests" / "data" / "agents" / "plain"


def measure(mode: str, steps: int) -> tuple[float, float]:
    """Returns the time until an agent is ready, and the time of a decision [ms]."""
    driver = find_driver(str(_AGENT))
    spaces = kart_observation_space(), kart_action_space()
    request = DriverRequest("kart_0", *spaces, 0, DriverLimits(sandbox=mode))
    seen = request.observation_space.sample()
    assert driver.start is not None  # noqa: S101 - not the game's AI
    begin = time.perf_counter()
    instance = driver.start(request)
    instance.ready()
    ready = time.perf_counter()
    for _ in range(steps):
        instance.ask(seen)
        instance.answer()
    end = time.perf_counter()
    instance.close()
    return 1e3 * (ready - begin), 1e3 * (end - ready) / steps


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.sandbox", description=__doc__)
    parser.add_argument("--starts", type=int, default=15, help="starts with each sandbox")
    parser.add_argument("--steps", type=int, default=1000, help="decisions after each start")
    arguments = parser.parse_args()
    print(f"auto is {sandbox.sandbox_kind('auto')} here")
    times: dict[str, list[tuple[float, float]]] = {"off": [], "auto": []}
    for _ in range(arguments.starts):  # in turn, so that other load affects both
        for mode, rows in times.items():
            rows.append(measure(mode, arguments.steps))
    for mode, rows in times.items():
        start, step = map(statistics.median, zip(*rows, strict=True))
        print(f"{mode:>5}: start {start:6.1f} ms, decision {step:.3f} ms")


if __name__ == "__main__":
    main()
