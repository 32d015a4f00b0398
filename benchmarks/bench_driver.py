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

from benchmarks.bench_controls import PHYSICAL, driving_style
from stkzoo.engine.assets import find_assets

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = [
    "WARMUP",
    "Contender",
    "Interpreter",
    "Spec",
    "Times",
    "answer_of",
    "contenders",
    "engine_variables",
    "race_together",
    "record_controls",
]

#: Steps before the measured ones, for the start of the race and the reference's compilation.
WARMUP = 40
_SEED = 1  # of the race and of the controls

#: Duration of each measured step of a contender [s]: ``total`` for the caller, ``engine`` inside
#: ``pystk2.Race.step`` (``None`` if not measured).
Times = dict[str, list[Any]]


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


class Interpreter:
    """A separate interpreter that answers requests, one line of JSON each.

    Args:
        name: name in error messages.
        words: arguments of the interpreter.
        env: environment variables.

    Raises:
        RuntimeError: a request failed; the message ends with the output of the process.
    """

    def __init__(self, name: str, words: Sequence[str], env: Mapping[str, str]) -> None:
        self._name = name
        self._log: IO[bytes] = tempfile.TemporaryFile(prefix="stkzoo-bench-")  # noqa: SIM115
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and words
            [sys.executable, *words],
            cwd=Path(__file__).parents[1],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=env,
        )

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
            raise RuntimeError(f"{self._name} failed at {what!r}:\n{self._tail()}")
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
        try:
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise RuntimeError(f"{self._name} is gone:\n{self._tail()}") from None

    def _tail(self) -> str:
        self._log.seek(0)
        return self._log.read().decode(errors="replace")[-3000:]


class Contender(Interpreter):
    """A contender; its requests are the methods of the server in ``bench_contenders``.

    Args:
        spec: definition of the contender.

    Raises:
        RuntimeError: a request failed; the message ends with the output of the process.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        env = os.environ | (engine_variables() if spec.kind != "stkzoo" else {})
        super().__init__(str(spec), ["-W", "ignore", "-m", "benchmarks.bench_contenders"], env)
        self._send(asdict(spec))


def answer_of(
    module: str,
    spec: Mapping[str, Any],
    words: Sequence[str],
    variables: Mapping[str, str],
    python: str = sys.executable,
) -> Any:
    """Runs a command of this folder for one ``--contender``; returns the JSON that it prints.

    Args:
        module: module of the command, which runs in a separate interpreter.
        spec: the contender.
        words: further arguments.
        variables: further environment variables.
        python: path of the interpreter.
    """
    command = [python, "-m", f"benchmarks.{module}", "--contender", json.dumps(spec)]
    answer = subprocess.run(  # noqa: S603 - our own interpreter and words
        [*command, *words],
        cwd=Path(__file__).parents[1],
        env={**os.environ, **variables},
        capture_output=True,
        check=False,
        text=True,
    )
    if answer.returncode:
        raise SystemExit(f"{spec} failed:\n{answer.stderr[-3000:]}")
    return json.loads(answer.stdout.splitlines()[-1])


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
    started: Mapping[str, Contender],
    *,
    track: str,
    steps: int,
    block: int = 20,
    driving: str = "heuristic",
    advance: Callable[[int], None] | None = None,
) -> tuple[dict[str, Times], bool]:
    """Runs the same race in all contenders, a few steps of each in turn.

    Args:
        started: contenders by name; if one is of stkzoo, it draws the race for all.
        track: name of the track.
        steps: measured steps of each contender.
        block: consecutive steps of a contender in its turn.
        driving: ``heuristic`` repeats the recorded controls of a driver; ``random`` is random.
        advance: called with the number of measured steps after each turn.

    Returns:
        Times by contender, and whether all ran the same race, bit for bit.
    """
    some = next(iter(started.values())).spec
    controls = None
    if driving == "heuristic":
        style = driving_style(some.view)
        controls = record_controls(
            track, some.num_kart, some.num_agents, _SEED, WARMUP + steps, style
        )
    names = sorted(started, key=lambda name: started[name].spec.kind != "stkzoo")
    race = None
    for name in names:
        started[name].ask("reset", track=track, seed=_SEED, race=race, controls=controls)
        race = race or started[name].ask("race")
    times: dict[str, Times] = {name: {"total": [], "engine": []} for name in names}
    for name in names:
        started[name].ask("steps", count=WARMUP)
    for turn, count in enumerate(_blocks(steps, block)):
        first = turn % len(names)
        for name in names[first:] + names[:first]:
            for part, values in started[name].ask("steps", count=count).items():
                times[name][part].extend(values)
            if advance is not None:
                advance(count)
    ends = [started[name].ask("distances") for name in names]
    return times, all(end == ends[0] for end in ends)


@functools.cache
def record_controls(
    track: str, num_kart: int, num_agents: int, seed: int, count: int, style: str = "grid"
) -> list[list[list[float]]]:
    """Records a driver's controls of a race, which all contenders then repeat.

    The driver is the heuristic, or ``pursuit`` if the style is physical.

    Moving karts cost the engine less than karts that are stuck at a wall. With random controls,
    the ratios to the engine's time would look too good.

    Args:
        track: name of the track.
        num_kart: number of karts.
        num_agents: number of karts to record; the game drives the others.
        seed: seed of the race.
        count: number of steps N.
        style: see :func:`benchmarks.bench_controls.driving_style`.

    Returns:
        ``(N, K, 7)``, rows as in :meth:`benchmarks.bench_controls.Controls.next`.
    """
    view = "control of full" if style == PHYSICAL else "full"
    spec = Spec("stkzoo", "parallel", view, num_kart, num_agents, subprocess=True)
    with Contender(spec) as recorder:
        recorder.ask("load")
        recorder.ask("make")
        rows: list[list[list[float]]] = recorder.ask(
            "record", track=track, seed=seed, count=count, style=style
        )
    return rows


def _blocks(steps: int, block: int) -> Sequence[int]:
    return [min(block, steps - start) for start in range(0, steps, block)]
