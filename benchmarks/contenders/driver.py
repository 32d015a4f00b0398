"""Starts contenders in separate interpreters, and runs the same race in all of them."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from benchmarks.common import Times
from benchmarks.contenders.controls import PHYSICAL, driving_style
from stkzoo.engine.assets import find_assets

if TYPE_CHECKING:
    from typing_extensions import Self

_ROOT = Path(__file__).parents[2]
#: Steps before the measured ones, for the start of the race and the reference's compilation.
WARMUP = 40
#: Consecutive steps of a contender in its turn.
_BLOCK = 20
_SEED = 1  # of the race


@dataclass(frozen=True)
class Spec:
    """Definition of a contender.

    Attributes:
        kind: ``bare`` (the engine alone), ``stkzoo`` or ``reference`` (pystk2-gymnasium).
        api: ``parallel``, ``multi`` (the id multi-full-v0) or ``single`` (one kart's ids).
        view: the view, for ``parallel`` and ``single``.
        num_kart: number of karts.
        num_agents: number of karts driven by actions; the game drives the others.
        subprocess: whether the game runs in a separate process.
        cores: cores that the contender may use; empty for all.
        events: whether the contender, with the api ``parallel``, counts events.
    """

    kind: str
    api: str = "parallel"
    view: str = "full"
    num_kart: int = 3
    num_agents: int = 3
    subprocess: bool = False
    cores: tuple[int, ...] = ()
    events: bool = False


class Contender:
    """A separate interpreter that answers requests: the methods in ``contenders.process``.

    Args:
        spec: definition of the contender.

    Raises:
        RuntimeError: a request failed; the message ends with the output of the process.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        self._log: IO[bytes] = tempfile.TemporaryFile(prefix="stkzoo-bench-")  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-m", "benchmarks.contenders.process"],
            cwd=_ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | (engine_variables() if spec.kind != "stkzoo" else {}),
        )
        self._send(asdict(spec))

    @property
    def pid(self) -> int:
        """Process id of the interpreter."""
        return self._process.pid

    def ask(self, what: str, **arguments: Any) -> Any:
        """Sends a request and waits for its answer."""
        self._send({"do": what, **arguments})
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            self._process.wait()
            self._log.seek(0)
            said = self._log.read().decode(errors="replace")[-3000:]
            raise RuntimeError(f"{self.spec} failed at {what!r}:\n{said}")
        return json.loads(line)

    def close(self) -> None:
        """Ends the interpreter."""
        try:
            self._process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
        self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _send(self, message: Mapping[str, Any]) -> None:
        if self._process.stdin is None:
            raise RuntimeError("the interpreter was closed; make a new one")
        self._process.stdin.write(json.dumps(message) + "\n")
        self._process.stdin.flush()


def answer_of(function: Callable[..., Any], *arguments: Any) -> Any:
    """Calls a function of a module in a new interpreter; arguments and result are JSON."""
    code = (
        "import json, os, sys\n"
        "answer = os.fdopen(os.dup(1), 'w')\n"
        "os.dup2(2, 1)\n"  # the game prints to stdout
        f"from {function.__module__} import {function.__name__} as function\n"
        "print(json.dumps(function(*json.loads(sys.argv[1]))), file=answer)"
    )
    answer = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, json.dumps(arguments)],
        cwd=_ROOT,
        env={**os.environ, **engine_variables()},
        capture_output=True,
        check=False,
        text=True,
    )
    if answer.returncode:
        raise SystemExit(f"{function.__name__}{arguments} failed:\n{answer.stderr[-3000:]}")
    return json.loads(answer.stdout)


def engine_variables() -> dict[str, str]:
    """Returns variables for the same game data and BLAS threads as in stkzoo's engine processes."""
    return {
        "SUPERTUXKART_DATADIR": str(find_assets().root),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }


@contextmanager
def contenders(specs: Mapping[str, Spec]) -> Iterator[dict[str, Contender]]:
    """Starts contenders one after another; yields them by name, with environments made."""
    with ExitStack() as stack:
        started = {name: stack.enter_context(Contender(spec)) for name, spec in specs.items()}
        for contender in started.values():
            contender.ask("load")
            contender.ask("make")
        yield started


def race_together(
    started: Mapping[str, Contender], track: str, steps: int
) -> tuple[dict[str, Times], bool]:
    """Runs the same race in all contenders, a few steps of each in turn.

    Args:
        started: contenders by name; if one is of stkzoo, it draws the race for all.
        track: name of the track.
        steps: measured steps of each contender.

    Returns:
        Times by contender, and whether all ran the same race, bit for bit.
    """
    some = next(iter(started.values())).spec
    controls = record_controls(
        track, some.num_kart, some.num_agents, WARMUP + steps, driving_style(some.view)
    )
    names = sorted(started, key=lambda name: started[name].spec.kind != "stkzoo")
    race = None
    for name in names:
        started[name].ask("reset", track=track, seed=_SEED, race=race, controls=controls)
        race = race or started[name].ask("race")
    times: dict[str, Times] = {name: {"total": [], "engine": []} for name in names}
    for name in names:
        started[name].ask("steps", count=WARMUP)
    for turn, start in enumerate(range(0, steps, _BLOCK)):
        first = turn % len(names)
        for name in names[first:] + names[:first]:
            answer = started[name].ask("steps", count=min(_BLOCK, steps - start))
            for part, values in answer.items():
                times[name][part].extend(values)
    ends = [started[name].ask("distances") for name in names]
    return times, all(end == ends[0] for end in ends)


@functools.cache
def record_controls(
    track: str, num_kart: int, num_agents: int, count: int, style: str = "grid"
) -> Sequence[Any]:
    """Records a driver's controls of a race, which all contenders then repeat.

    The driver is the heuristic, or ``pursuit`` if the style is physical. Moving karts cost the
    engine less than karts that are stuck at a wall, so with random controls, the ratios to the
    engine's time would look too good.

    Args:
        track: name of the track.
        num_kart: number of karts.
        num_agents: number of karts to record; the game drives the others.
        count: number of steps N.
        style: see :func:`benchmarks.contenders.controls.driving_style`.

    Returns:
        ``(N, K, 7)``, a row of controls for each step and kart.
    """
    view = "control of full" if style == PHYSICAL else "full"
    spec = Spec("stkzoo", "parallel", view, num_kart, num_agents, subprocess=True)
    with contenders({"recorder": spec}) as started:
        rows: Sequence[Any] = started["recorder"].ask(
            "record", track=track, seed=_SEED, count=count, style=style
        )
    return rows
