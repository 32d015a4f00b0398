"""Contenders, as seen by the program that measures them."""

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

#: Steps before the measured ones: the start, and the reference's compiler.
WARMUP = 40

#: Seconds of every measured step of a contender: ``total`` for the caller, ``engine`` inside
#: ``pystk2.Race.step`` (``None``: not measured).
Times = dict[str, list[Any]]


@dataclass(frozen=True)
class Spec:
    """What a contender is.

    Attributes:
        kind: ``bare`` (the engine alone), ``stkzoo`` or ``reference`` (pystk2-gymnasium).
        api: ``parallel``, ``multi`` (the id multi-full-v0) or ``single`` (one kart's ids).
        view: the view, for ``parallel`` and ``single``.
        num_kart: number of karts.
        num_agents: how many of them are driven by actions, the rest by the game.
        subprocess: whether the game runs in a process of its own.
        cores: cores that the contender may use; any if empty.
        kernel: whether the contender may use stkzoo's compiled kernel.
        events: whether the contender, with the api ``parallel``, counts events.
    """

    kind: str
    api: str = "parallel"
    view: str = "full"
    num_kart: int = 3
    num_agents: int = 3
    subprocess: bool = False
    cores: tuple[int, ...] = ()
    kernel: bool = True
    events: bool = False


class Interpreter:
    """An interpreter of its own that answers requests, a line of JSON each.

    Args:
        name: what errors call it.
        words: arguments of the interpreter.
        env: its environment.

    Raises:
        RuntimeError: a request failed; the text ends with what the process wrote.
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
        """Its process id."""
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
    """One contender; its requests are the methods of the contender's server.

    Args:
        spec: what it is.

    Raises:
        RuntimeError: a request failed; the text ends with what the process wrote.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        env = os.environ | (engine_variables() if spec.kind != "stkzoo" else {})
        env |= {} if spec.kernel else {"STKZOO_KERNEL": "off"}
        super().__init__(str(spec), ["-W", "ignore", "-m", "benchmarks.bench_contenders"], env)
        self._send(asdict(spec))


def answer_of(
    module: str,
    spec: Mapping[str, Any],
    words: Sequence[str],
    variables: Mapping[str, str],
    python: str = sys.executable,
) -> Any:
    """What a command of this folder prints as JSON for one ``--contender``.

    Args:
        module: the command's, which runs in an interpreter of its own.
        spec: the contender.
        words: more arguments.
        variables: more environment variables.
        python: the interpreter.
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
    """The same data and calm BLAS that stkzoo gives its engine processes."""
    return {
        "SUPERTUXKART_DATADIR": str(find_assets().root),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }


@contextmanager
def contenders(specs: Mapping[str, Spec]) -> Iterator[dict[str, Contender]]:
    """Contenders by name, imported and made, one after the other."""
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
    warmup: int = WARMUP,
    block: int = 20,
    seed: int = 1,
    driving: str = "heuristic",
    advance: Callable[[int], None] | None = None,
) -> tuple[dict[str, Times], bool]:
    """Runs the same race in all contenders, a few steps of each in turn.

    Args:
        started: contenders; one of stkzoo, if there is one, draws the race for all.
        track: the track.
        steps: measured steps of each.
        warmup: steps before them, which are not measured.
        block: steps of one contender before it is the next one's turn.
        seed: of the race and the driving.
        driving: ``heuristic`` repeats recorded sensible driving, ``random`` is erratic.
        advance: called with the number of measured steps.

    Returns:
        Times by contender, and whether all ran the same race to the last bit.
    """
    some = next(iter(started.values())).spec
    controls = None
    if driving == "heuristic":
        style = driving_style(some.view)
        controls = record_controls(
            track, some.num_kart, some.num_agents, seed, warmup + steps, style
        )
    names = sorted(started, key=lambda name: started[name].spec.kind != "stkzoo")
    race = None
    for name in names:
        started[name].ask("reset", track=track, seed=seed, race=race, controls=controls)
        race = race or started[name].ask("race")
    times: dict[str, Times] = {name: {"total": [], "engine": []} for name in names}
    for name in names:
        started[name].ask("steps", count=warmup)
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
    """A driver's driving of a race, which all contenders then repeat.

    The heuristic driver drives; ``pursuit`` where the style is physical.

    Karts that drive cost the engine less than karts that stand at a wall: without
    sensible driving, every ratio to the engine's time would look too good.

    Args:
        track: the track.
        num_kart: number of karts.
        num_agents: how many of them are driven; the game drives the others.
        seed: of the race.
        count: number of steps N.
        style: what the view can express, :func:`benchmarks.bench_controls.driving_style`.

    Returns:
        ``(N, K, 7)``, as :meth:`benchmarks.bench_controls.Controls.next`.
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
