"""The process of one contender: it answers requests and measures their time.

:class:`benchmarks.contenders.driver.Contender` starts this module and sends requests as lines of
JSON. Heavy imports happen on request, so that they can be timed.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

from benchmarks.contenders.runners import runner_for
from benchmarks.contenders.timing import CLOCK_VARIABLE, Clock, time_the_engine

#: Time limit of a request [s]. It ends the process, because its parent may be gone.
_MAX_REQUEST_SECONDS = 900


class _Server:
    """Answers requests; each public method is one kind of request."""

    def __init__(self, spec: dict[str, Any]) -> None:
        self._clock = Clock()
        os.environ[CLOCK_VARIABLE] = self._clock.path
        time_the_engine(self._clock)
        self._runner = runner_for(spec)
        self._num_kart = spec["num_kart"]

    def load(self) -> float:
        """Imports the library; returns the duration [s]."""
        return _seconds(self._runner.load)

    def make(self) -> float:
        """Makes the environment; returns the duration [s]."""
        return _seconds(self._runner.make)

    def reset(
        self, track: str, seed: int, race: dict[str, Any] | None = None, controls: Any = None
    ) -> float:
        """Resets; returns the duration [s]. Later steps repeat ``controls``, or full throttle."""
        seconds = _seconds(self._runner.reset, track, seed, race)
        import numpy as np

        from benchmarks.contenders.controls import FULL_THROTTLE

        self._controls = np.array(controls or [[FULL_THROTTLE] * self._num_kart])
        self._step = 0
        return seconds

    def record(self, track: str, seed: int, count: int, style: str) -> list[list[list[float]]]:
        """Returns a driver's controls for the agents of a race; the game's karts have zeros."""
        from benchmarks.contenders.controls import PHYSICAL, controls_of, to_action

        if style == PHYSICAL:
            from stkzoo.agents.pursuit import create_state, get_actor
        else:
            from stkzoo.agents.heuristic import create_state, get_actor
        env, drive = self._runner.env, get_actor(None, None, None)  # type: ignore[attr-defined]
        observations, _ = env.reset(seed=seed, options={"track": track})
        states = {agent: create_state() for agent in env.agents}
        view = "control" if style == PHYSICAL else "full"
        rows = []
        for _ in range(count):
            row = [[0.0] * 7 for _ in range(self._num_kart)]
            actions = {}
            for agent, kart in zip(env.agents, env.race.kart_indices, strict=True):
                row[kart] = controls_of(style, drive(states[agent], observations[agent]))
                actions[agent] = to_action(view, row[kart])
            observations, *_ = env.step(actions)
            rows.append(row)
        return rows

    def race(self) -> dict[str, Any]:
        """Returns the engine seed and the agents' karts of the current race."""
        return self._runner.race()

    def steps(self, count: int) -> dict[str, list[float | None]]:
        """Makes steps; returns the duration of each, in total and inside ``Race.step`` [s]."""
        runner, clock = self._runner, self._clock
        times: dict[str, list[float | None]] = {"total": [], "engine": []}
        for _ in range(count):
            action = runner.action(self._controls[self._step % len(self._controls)])
            self._step += 1
            start = time.perf_counter()
            self.last = runner.step(action)
            times["total"].append(time.perf_counter() - start)
            times["engine"].append(clock.take())
        return times

    def distances(self) -> list[float]:
        """Returns the overall distance of each kart [m]."""
        return self._runner.distances()


def _seconds(function: Callable[..., Any], *arguments: Any) -> float:
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def _let_forks_die_with_this() -> None:
    """Ends all processes that the reference forks when this process ends."""
    if sys.platform != "linux":
        return
    import ctypes

    prctl = ctypes.CDLL(None).prctl
    # 1 is PR_SET_PDEATHSIG
    os.register_at_fork(after_in_child=lambda: prctl(1, signal.SIGKILL))


def serve() -> None:
    """Runs the contender's process: reads requests and writes answers, one per line, until EOF."""
    _let_forks_die_with_this()
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # the engine prints to stdout
    spec = json.loads(sys.stdin.readline())
    if spec["cores"] and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, spec["cores"])
    with tempfile.TemporaryDirectory(prefix="stkzoo-bench-") as home:
        if spec["kind"] == "stkzoo":
            folder = str(Path(__file__).parent / "instrument")
            paths = [folder, *filter(None, [os.environ.get("PYTHONPATH")])]
            os.environ["PYTHONPATH"] = os.pathsep.join(paths)
        else:
            os.environ["HOME"] = home  # the user's settings must not affect the race
        _answer_all(_Server(spec), replies)


def _answer_all(server: _Server, replies: TextIO) -> None:
    for line in sys.stdin:
        if hasattr(signal, "alarm"):
            signal.alarm(_MAX_REQUEST_SECONDS)  # ends this process if the game hangs
        request = json.loads(line)
        answer = getattr(server, request.pop("do"))(**request)
        replies.write(json.dumps(answer) + "\n")
        if hasattr(signal, "alarm"):
            signal.alarm(0)


if __name__ == "__main__":
    serve()
