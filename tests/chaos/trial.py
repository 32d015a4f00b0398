"""Injects one fault after another into this program and checks the state after each."""

from __future__ import annotations

import contextlib
import gc
import os
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo import race_v0
from stkzoo.engine import fork_client, process, render_session, session
from stkzoo.errors import EngineError, StkzooError
from tests.chaos.family import family
from tests.chaos.faults import Fault, Strike
from tests.chaos.forms import ENGINE_TIMEOUT, FORMS, TRACK, Form
from tests.support.playing import fingerprint
from tests.support.processes import wait_until

__all__ = ["Outcome", "Trials"]

#: Time limit for the start of a race [s]; the default is a minute.
START_TIMEOUT = 20.0
#: The same for rendered races, and for their images; the first images may take 10 times as long.
DRAWING_START_TIMEOUT, DRAWING_TIMEOUT = 30.0, 4.0
#: Time limit for a form to answer or to be abandoned after a fault [s].
_LIMIT = 3 * (START_TIMEOUT + ENGINE_TIMEOUT)
_DRAWING_LIMIT = _LIMIT + DRAWING_START_TIMEOUT + 10 * DRAWING_TIMEOUT
#: Maximum number of resets until a form races again; a fault may show late.
_ATTEMPTS = 3
#: Moments that begin without an environment.
_FIRST = ("construct", "begin")
_SETTLE = 10.0  # [s]
_WITNESS_STEPS = 60


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a fault.

    Attributes:
        fault: the fault.
        injected: whether a process was hit.
        survived: whether all checks passed afterwards.
        answer: name of the error that the form raised, or ``"went on"`` or ``"recovered"``.
        seconds: time until that answer [s].
        resets: number of resets until the form raced again.
        problem: description of the failed check.
    """

    fault: Fault
    injected: bool
    survived: bool
    answer: str
    seconds: float
    resets: int
    problem: str = ""


class Trials:
    """Injects faults into this program while another race runs, which must not be affected.

    A context manager. Temporary files go to a separate folder. The engine's timeouts are short
    while a fault is injected, but not while a form's normal behavior is recorded.
    """

    def __enter__(self) -> Trials:
        self._folder = tempfile.TemporaryDirectory(prefix="chaos-")
        self._patches = contextlib.ExitStack()
        self._patches.enter_context(_replaced(tempfile, "tempdir", self._folder.name))
        fork_client._close_all()  # so that the new fork server's folder is in that folder
        self._not_ours = {member.pid for member in family(os.getpid())}  # from earlier tests
        self._witness = _Witness()
        self._traces: dict[str, str] = {}
        self._durations: dict[tuple[str, str], float] = {}
        self._numbers: dict[str, tuple[int, int]] = {}
        return self

    def __exit__(self, *_: object) -> None:
        self._witness.close()
        fork_client._close_all()
        self._patches.close()
        self._folder.cleanup()

    def run(self, fault: Fault) -> Outcome:
        """Injects one fault and returns its outcome."""
        with warnings.catch_warnings():
            # Python warns when it closes files that an interrupted call left open. The check of
            # open files shows that it does close them.
            if fault.signal == "SIGINT":
                warnings.simplefilter("ignore", ResourceWarning)
            self._learn(fault.form, fault.moment)
            with _short_timeouts():
                return self._run(fault)

    def _run(self, fault: Fault) -> Outcome:
        form = FORMS[fault.form]()
        strike = Strike(fault, os.getpid(), self._witness.pids)
        begin = time.monotonic()
        answer, resets = "", 0
        try:
            answer = self._hit(form, fault, strike)
            seconds = time.monotonic() - begin
            limit = _DRAWING_LIMIT if "drawn" in form.name else _LIMIT
            self._check(seconds < limit, f"it took {seconds:.1f} s")
            resets = self._race_again(form)
            self._witness.go_on(
                may_be_lost=fault.target == "fork server" or fault.moment == "begin"
            )
            form.close()
            self._check_nothing_is_left(form)
        except Exception:  # noqa: BLE001 - any error is a finding
            problem = traceback.format_exc()
            form.close()
        else:
            problem = ""
        del form
        seconds = time.monotonic() - begin
        return Outcome(fault, strike.pid is not None, not problem, answer, seconds, resets, problem)

    # ------------------------------------------------------------------ one fault

    def _hit(self, form: Form, fault: Fault, strike: Strike) -> str:
        if fault.moment not in _FIRST:
            form.construct()
            form.reset()
        before = form.num_crashes
        try:
            with strike.during(self._durations[fault.form, fault.moment]):
                getattr(form, fault.moment)()
        except (StkzooError, KeyboardInterrupt) as error:
            return type(error).__name__
        return "recovered" if form.num_crashes > before else "went on"

    def _race_again(self, form: Form) -> int:
        """Resets until the form's race equals the recorded one; returns the number of resets."""
        for attempt in range(_ATTEMPTS):
            try:
                form.mend()
                crashes = form.num_crashes
                trace = form.trace()
            except StkzooError:
                continue
            if form.num_crashes > crashes:
                continue
            self._check(trace == self._traces[form.name], "the race differs from what it was")
            return attempt + 1
        raise AssertionError(f"no race after {_ATTEMPTS} resets")

    def _learn(self, name: str, moment: str) -> None:
        """Records a moment's duration and the form's race without faults."""
        if (name, moment) in self._durations:
            return
        form = FORMS[name]()
        for _ in range(2):  # the first run takes longer
            form.close()
            if moment not in _FIRST:
                form.construct()
                form.reset()
            begin = time.monotonic()
            getattr(form, moment)()
            self._durations[name, moment] = time.monotonic() - begin
        self._witness.go_on(may_be_lost=moment == "begin")
        form.close()
        if name not in self._traces:
            form.construct()
            self._traces[name] = form.trace()
            form.close()
        del form
        gc.collect()
        self._numbers[name] = _open_files(), threading.active_count()

    # ------------------------------------------------------------------ leftovers

    def _check_nothing_is_left(self, form: Form) -> None:
        gc.collect()
        files, threads = self._numbers[form.name]
        kept = {*self._witness.pids, *self._not_ours}
        others = lambda: [m for m in family(os.getpid()) if m.pid not in kept]  # noqa: E731
        rest = lambda: [m for m in others() if m.kind != "fork server"]  # noqa: E731
        self._check(wait_until(lambda: not rest(), _SETTLE), lambda: f"processes: {rest()}")
        self._check(len(others()) <= 1, lambda: f"several fork servers: {others()}")
        self._check(
            wait_until(lambda: _open_files() <= files, _SETTLE),
            lambda: f"{_open_files()} open files, {files} before: {_file_names()}",
        )
        self._check(
            wait_until(lambda: threading.active_count() <= threads, _SETTLE),
            lambda: f"threads: {threading.enumerate()}",
        )
        homes = lambda: list(Path(self._folder.name).iterdir())  # noqa: E731
        self._check(wait_until(lambda: len(homes()) <= 1, _SETTLE), lambda: f"files: {homes()}")

    def _check(self, holds: bool, problem: str | Callable[[], str]) -> None:
        if not holds:
            raise AssertionError(problem if isinstance(problem, str) else problem())


@contextlib.contextmanager
def _replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    old = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, old)


@contextlib.contextmanager
def _short_timeouts() -> Iterator[None]:
    drawing = {"has_window": False, "timeout": DRAWING_TIMEOUT}
    with (
        _replaced(process, "START_TIMEOUT", START_TIMEOUT),
        _replaced(fork_client, "START_TIMEOUT", START_TIMEOUT),
        _replaced(session, "START_TIMEOUT", START_TIMEOUT),
        _replaced(render_session, "DRAWING_START_TIMEOUT", DRAWING_START_TIMEOUT),
        _replaced(render_session.RenderSession.__init__, "__kwdefaults__", drawing),
    ):
        yield


class _Witness:
    """A race of this program that is never hit, and must continue bit for bit."""

    def __init__(self) -> None:
        self._env = race_v0.parallel_env(
            num_kart=3, agents=1, track=TRACK, view="flattened_discrete"
        )
        self._alone = [self._begin(), *(self._step() for _ in range(_WITNESS_STEPS))]
        self._begin()
        self._number = 0

    @property
    def pids(self) -> tuple[int, ...]:
        pid = self._env.live_race.session.pid
        return () if pid is None else (pid,)

    def go_on(self, *, may_be_lost: bool) -> None:
        """Takes some steps and compares them with the recorded race.

        Args:
            may_be_lost: whether the fork server of all races was hit.
        """
        for _ in range(3):
            self._number += 1
            try:
                seen = self._step()
            except EngineError:
                if not may_be_lost:
                    raise
                self._number = 0
                seen = self._begin()
            assert seen == self._alone[self._number], "another race has noticed"
            if self._number == _WITNESS_STEPS:
                self._number = 0
                assert self._begin() == self._alone[0], "another race starts otherwise"

    def close(self) -> None:
        self._env.close()

    def _begin(self) -> str:
        return fingerprint(self._env.reset(seed=3))

    def _step(self) -> str:
        return fingerprint(self._env.step({"kart_0": 700}))


def _open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def _file_names() -> list[str]:
    names = []
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):
            names.append(os.readlink(f"/proc/self/fd/{name}"))
    return sorted(names)
