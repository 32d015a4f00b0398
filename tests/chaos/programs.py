"""Faults in whole programs, and the checks of exit codes, output files and leftovers."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

from stkzoo._temporary import remove_stale_folders
from stkzoo.evaluation import resume_tournament
from tests.chaos.family import family, marked
from tests.chaos.faults import Fault, Strike
from tests.chaos.trial import Outcome
from tests.support.paths import AGENTS
from tests.support.processes import wait_until

__all__ = ["PROGRAMS", "Program", "ProgramTrials"]

_AGENT = AGENTS / "plain"
#: Time limit for a program to end after a fault [s].
_LIMIT = 90.0
_SETTLE = 15.0  # [s]
_RACES = 4

_SCRIPT = """
import sys
from stkzoo import StkzooError, race_v0

def drive(make, step):
    for _ in range(4):
        try:
            env = make()
            env.reset(seed=1)
            for _ in range(60):
                step(env)
        except StkzooError:
            continue
        env.close()
        return
    sys.exit("no race in four attempts")

"""

_PARALLEL = """
drive(
    lambda: race_v0.parallel_env(num_kart=2, track="olivermath", view="flattened_discrete"),
    lambda env: env.step(dict.fromkeys(env.agents, 700)),
)
"""


_VIDEO = """
from stkzoo.race import run_race
from stkzoo.race import RaceVideo
video = RaceVideo("out/race.mp4", backend="map", size=(160, 120), card_seconds=0.5)
try:
    run_race(["heuristic", "ai"], track="olivermath", max_steps=120, listeners=[video])
except StkzooError as error:
    sys.exit(f"stkzoo: {error}")
except KeyboardInterrupt:
    sys.exit(130)
"""


@dataclass(frozen=True, slots=True)
class Program:
    """A program in which faults occur.

    Attributes:
        name: name of the program in faults.
        words: arguments of the Python interpreter. The working folder contains an agent
            (``plain.zip``) and an empty folder ``out``.
        targets: roles of its processes.
        judge: checks the files in ``out``; raises ``AssertionError``.
        variables: additional environment variables.
    """

    name: str
    words: tuple[str, ...]
    targets: tuple[str, ...]
    judge: Callable[[Path], None]
    variables: tuple[tuple[str, str], ...] = ()


def _nothing(folder: Path) -> None:
    assert not list(folder.iterdir()), list(folder.iterdir())


def _race_files(folder: Path) -> None:
    """Checks that the existing files of a race are complete."""
    from stkzoo.race import RaceResult
    from stkzoo.race.replay import load_replay

    names = {path.name for path in folder.iterdir()}
    parts = {name for name in names if name.endswith(".part")}
    assert names - parts <= {"race.json", "race.stkz"}, names
    if "race.json" in names:
        RaceResult.from_json((folder / "race.json").read_text())
    if "race.stkz" in names:
        load_replay(folder / "race.stkz")


def _video_file(folder: Path) -> None:
    """Checks that the video can be decoded if it exists."""
    import imageio_ffmpeg

    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert names <= {"race.mp4"}, names
    if names:
        reader = imageio_ffmpeg.read_frames(str(folder / "race.mp4"))
        assert next(reader)["size"] == (160, 120)
        reader.close()


def _league(folder: Path) -> None:
    """Checks that an interrupted tournament can be resumed to its end."""
    if not (folder / "plan.json").exists():
        return
    assert resume_tournament(folder).is_complete
    assert len(list((folder / "races").glob("*.json"))) == _RACES
    assert not list(folder.rglob("*.part"))


_LIMITS = ("--track", "olivermath", "--seed", "3", "--action-timeout", "2", "--start-timeout", "10")
_RACE = ("-m", "stkzoo", "race", "plain.zip", "heuristic", "ai", "--max-steps", "150", *_LIMITS)
_KEPT = ("--output", "out/race.json", "--replay", "out/race.stkz")
_LEAGUE = ("-m", "stkzoo", "tournament", "heuristic", "ai", "plain.zip", "--races", str(_RACES))
_SHORT = ("--track", "olivermath", "--max-steps", "60", "--jobs", "2")
_SPAWN = (("STKZOO_START_METHOD", "spawn"),)
_ALL = ("race", "fork server", "program")

#: All programs by name.
PROGRAMS: dict[str, Program] = {
    program.name: program
    for program in (
        Program("a program", ("-c", _SCRIPT + _PARALLEL), _ALL, _nothing),
        Program("a program that spawns", ("-c", _SCRIPT + _PARALLEL), _ALL, _nothing, _SPAWN),
        Program("stkzoo race", (*_RACE, *_KEPT), (*_ALL, "agent"), _race_files),
        Program("a video", ("-c", _SCRIPT + _VIDEO), (*_ALL, "encoder"), _video_file),
        Program(
            "stkzoo tournament",
            (*_LEAGUE, *_SHORT, "--output", "out"),
            (*_ALL, "worker", "agent"),
            _league,
        ),
    )
}

_AGENT_FAILED, _INTERRUPTED = 3, 130


class ProgramTrials:
    """Injects faults into programs from outside, one per program. A context manager."""

    def __enter__(self) -> ProgramTrials:
        self._folder = tempfile.TemporaryDirectory(prefix="chaos-")
        self._durations: dict[str, float] = {}
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def start(self, name: str) -> _Run:
        """Starts a program without a fault."""
        return _Run(PROGRAMS[name], Path(self._folder.name))

    def run(self, fault: Fault) -> Outcome:
        """Starts the program, applies the fault, and checks the outcome."""
        if fault.form not in self._durations:
            begin = time.monotonic()
            run = self.start(fault.form)
            code = run.end()
            self._durations[fault.form] = time.monotonic() - begin
            assert code == 0, run.said
            run.look()
        run = self.start(fault.form)
        begin = time.monotonic()
        answer, problem, strike = "", "", Strike(fault, run.pid)
        try:
            with strike.during(self._durations[fault.form]):
                code = run.end()
            answer = f"exit code {code}"
            seconds = time.monotonic() - begin
            run.judge(code, fault, is_hit=strike.pid is not None)
        except Exception as error:  # noqa: BLE001 - any error is a finding
            problem = f"{type(error).__name__}: {error}\n{run.said}"
            seconds = time.monotonic() - begin
        finally:
            run.close()
        return Outcome(fault, strike.pid is not None, not problem, answer, seconds, 0, problem)


class _Run:
    """One run of a program."""

    def __init__(self, program: Program, home: Path) -> None:
        self._program = program
        self._mark = uuid.uuid4().hex
        self._folder = Path(tempfile.mkdtemp(dir=home))
        for name in ("tmp", "out"):
            (self._folder / name).mkdir()
        with zipfile.ZipFile(self._folder / "plain.zip", "w") as archive:
            for file in _AGENT.glob("*.py"):
                archive.write(file, file.name)
        self._log = self._folder / "log"
        variables = {
            "TMPDIR": str(self._folder / "tmp"),
            "STKZOO_CHAOS": self._mark,
            **dict(program.variables),
        }
        with self._log.open("w") as log:
            self._process = subprocess.Popen(
                [sys.executable, *program.words],
                cwd=self._folder,
                env={**os.environ, **variables},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.pid = self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether the program still runs."""
        return self._process.poll() is None

    @property
    def said(self) -> str:
        """The program's output."""
        return self._log.read_text(errors="replace")

    def end(self) -> int:
        """Waits for the program to end and returns its exit code."""
        return self._process.wait(_LIMIT)

    def judge(self, code: int, fault: Fault, *, is_hit: bool) -> None:
        """Checks the exit code, and that the program left nothing behind."""
        assert code in _codes(fault) if is_hit else code == 0, f"exit code {code}"
        told = "Traceback (most recent call last)" in self.said
        assert not told or _is_interrupt_outside(self.said), "a traceback"
        self.look(is_killed=code in (-signal.SIGKILL, -signal.SIGTERM))

    def look(self, *, is_killed: bool = False) -> None:
        """Checks that no processes, no temporary files and only complete output files remain."""
        rest = lambda: marked(self._mark)  # noqa: E731
        assert wait_until(lambda: not rest(), _SETTLE), f"processes: {_names(rest())}"
        files = lambda: list((self._folder / "tmp").iterdir())  # noqa: E731
        if is_killed:  # the next program removes its files
            wait_until(lambda: not files(), 1.0)
            with mock.patch.object(tempfile, "tempdir", str(self._folder / "tmp")):
                remove_stale_folders()
        assert wait_until(lambda: not files(), _SETTLE), f"temporary files: {files()}"
        self._program.judge(self._folder / "out")

    def close(self) -> None:
        """Kills the remaining processes and removes the folder."""
        for member in [*family(self.pid)]:
            os.kill(member.pid, signal.SIGKILL)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        for pid in marked(self._mark):
            os.kill(pid, signal.SIGKILL)
        shutil.rmtree(self._folder, ignore_errors=True)


def _codes(fault: Fault) -> tuple[int, ...]:
    """Returns the permitted exit codes after a fault."""
    if fault.target != "program":
        return 0, 1, _AGENT_FAILED
    if fault.signal == "SIGINT":
        return 0, _AGENT_FAILED, _INTERRUPTED, -signal.SIGINT
    if fault.signal == "PAUSE":
        return 0, _AGENT_FAILED
    number = signal.Signals[fault.signal]
    return 0, _AGENT_FAILED, -number, 128 + number


def _is_interrupt_outside(said: str) -> bool:
    """Returns whether a traceback is Python's own for Ctrl-C."""
    return said.rstrip().endswith("KeyboardInterrupt")


def _names(pids: list[int]) -> list[str]:
    names = []
    for pid in pids:
        with contextlib.suppress(OSError):
            names.append(Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")[:300])
    return names
