"""Engine processes start fast, end with the program, and never make it hang."""

import contextlib
import ctypes
import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import numpy as np
import pytest

from stkzoo._temporary import remove_stale_folders
from stkzoo.engine import fork_client
from stkzoo.engine.assets import find_assets
from stkzoo.engine.session import LocalSession, WorkerSession
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.errors import ApiOrderError, EngineCrashed, EngineError, EngineTimeout
from tests.support.paths import ROOT
from tests.support.processes import process_exists, run_program, wait_until

PLAYER = KartSetup(is_bot=False)
BOT = KartSetup()
SETUP = RaceSetup("olivermath", (PLAYER, BOT, BOT), seed=5)


def full_throttle(rows=1):
    controls = np.zeros((rows, 7), np.float32)
    controls[:, 0] = 1
    return controls


def drive_on(session, steps=100):
    for _ in range(steps):
        session.step(full_throttle())


def trajectory(session, steps=80):
    session.start(SETUP)
    return b"".join(session.step(full_throttle()).data for _ in range(steps))


@pytest.fixture
def root():
    return find_assets().root


@pytest.fixture
def session(root):
    session = WorkerSession(root)
    yield session
    session.close()


@pytest.fixture
def default_timeout():
    """Gives new sockets of the test a timeout, as programs with network connections do."""
    socket.setdefaulttimeout(20.0)
    yield
    socket.setdefaulttimeout(None)


@pytest.mark.usefixtures("default_timeout")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_default_timeout_of_sockets_does_not_reach_the_game(root, monkeypatch, method):
    monkeypatch.setenv("STKZOO_START_METHOD", method)
    with contextlib.closing(WorkerSession(root)) as session:
        session.start(SETUP)
        drive_on(session, steps=2)


@pytest.mark.slow
def test_the_engine_imports_nothing_from_the_current_folder_of_a_notebook(root, tmp_path):
    (tmp_path / "socket.py").write_text("raise ImportError('a file of an agent')")
    code = f"""
        import sys
        sys.path.remove("")
        from pathlib import Path
        from stkzoo.engine.session import WorkerSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        sys.path.insert(0, "")  # as a notebook does after its imports
        session = WorkerSession(Path({str(root)!r}))
        print(session.start(RaceSetup("olivermath", (KartSetup(),))).snapshot.phase)
    """
    program = run_program(code, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert program.stdout == "0\n", program.stderr


def personality_of(pid):
    return int(Path(f"/proc/{pid}/personality").read_text(), 16)


def can_fix_addresses():
    return (
        shutil.which("setarch")
        and not subprocess.run(["setarch", "-R", "true"], check=False).returncode
    )


@pytest.mark.skipif(not can_fix_addresses(), reason="the system keeps addresses random")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_games_have_fixed_addresses_and_the_program_is_unchanged(root, monkeypatch, method):
    monkeypatch.setenv("STKZOO_START_METHOD", method)
    own = personality_of(os.getpid())
    with contextlib.closing(WorkerSession(root)) as session:
        session.start(SETUP)
        assert personality_of(session.pid) & 0x0040000
        assert personality_of(os.getpid()) == own


@pytest.mark.slow
def test_forked_spawned_and_local_races_are_the_same(root, session, monkeypatch):
    forked = trajectory(session)
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")
    spawned = WorkerSession(root)
    assert trajectory(spawned) == forked
    spawned.close()
    code = f"""
        import hashlib, sys
        from pathlib import Path
        from stkzoo.engine.session import LocalSession
        sys.path.insert(0, {str(ROOT)!r})
        from tests.engine.test_process import trajectory
        print(hashlib.sha256(trajectory(LocalSession(Path({str(root)!r})))).hexdigest())
    """
    assert run_program(code).stdout.split()[-1] == hashlib.sha256(forked).hexdigest()


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGSEGV, signal.SIGTERM])
def test_a_killed_game_is_an_error_and_the_next_start_works(session, sign):
    session.start(SETUP)
    os.kill(session.pid, sign)
    with pytest.raises(EngineCrashed, match=f"{sign.name}.*reset"):
        drive_on(session)
    with pytest.raises(ApiOrderError, match="reset"):
        drive_on(session)
    assert len(trajectory(session)) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stk_config.xml", "tracks/olivermath/olivermath_track.spm"])
def test_a_crash_because_of_damaged_data_says_how_to_replace_it(name, root, tmp_path):
    copy = Path(shutil.copytree(root, tmp_path / "copy", copy_function=os.symlink))
    (file,) = copy.rglob(name)
    data = file.read_bytes()
    file.unlink()
    file.write_bytes(data[: len(data) // 2])
    session = WorkerSession(copy)
    with pytest.raises(EngineCrashed, match="replace it: `stkzoo assets install --force`"):
        session.start(SETUP)
    session.close()


@pytest.mark.slow
def test_a_stopped_game_times_out_and_is_ended(root):
    session = WorkerSession(root, timeout=0.3)
    session.start(SETUP)
    pid = session.pid
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(EngineTimeout, match=r"did not answer within 0\.3 s"):
        session.step(full_throttle())
    assert wait_until(lambda: not process_exists(pid))
    assert len(trajectory(session)) > 0
    session.close()


@pytest.mark.slow
def test_a_killed_fork_server_is_replaced(root, session):
    expected = trajectory(session)
    fork_server = fork_client.start_fork_server(root)
    os.kill(fork_server._process.pid, signal.SIGKILL)
    fork_server._process.wait()
    with pytest.raises(EngineCrashed):
        drive_on(session)
    assert trajectory(session) == expected
    assert fork_client.start_fork_server(root) is not fork_server


def test_an_engine_error_has_the_games_error_message(session):
    with pytest.raises(EngineError, match="not_a_track"):
        session.start(RaceSetup("not_a_track", (PLAYER,)))


def test_an_interrupted_step_does_not_mix_up_replies(session):
    session.start(SETUP)
    main_thread = threading.main_thread().ident
    raise_in = ctypes.pythonapi.PyThreadState_SetAsyncExc
    timer = threading.Timer(
        0.05, lambda: raise_in(ctypes.c_ulong(main_thread), ctypes.py_object(KeyboardInterrupt))
    )
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        drive_on(session, steps=10**6)
    assert len(trajectory(session)) > 0


PROGRAM = """
    import sys, time, os, signal
    import numpy as np
    from pathlib import Path
    from stkzoo.engine import fork_client
    from stkzoo.engine.session import WorkerSession
    from stkzoo.engine.setup import KartSetup, RaceSetup
    session = WorkerSession(Path({root!r}))
    session.start(RaceSetup("olivermath", (KartSetup(is_bot=False), KartSetup())))
    print(session.pid, fork_client.start_fork_server(Path({root!r}))._process.pid,
          fork_client.start_fork_server(Path({root!r}))._home.path, flush=True)
    {ending}
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "ending",
    [
        "pass",
        "os._exit(3)",
        "os.kill(os.getpid(), signal.SIGKILL)",
        "os.kill(session.pid, signal.SIGSTOP); os.kill(os.getpid(), signal.SIGKILL)",
        "time.sleep(4) if os.fork() == 0 else os.kill(os.getpid(), signal.SIGKILL)",
    ],
    ids=["normal", "exit", "killed", "killed-with-stopped-game", "killed-with-forked-child"],
)
def test_no_process_outlives_the_program(root, ending):
    program = textwrap.dedent(PROGRAM).format(root=str(root), ending=textwrap.dedent(ending))
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    race, fork_server, home = child.stdout.readline().split()
    child.stdout.close()
    child.wait(30)
    assert wait_until(lambda: not process_exists(race) and not process_exists(fork_server))
    if ending != "pass":
        assert wait_until(lambda: remove_stale_folders() or not Path(home).exists())
    assert not Path(home).exists()


def test_the_races_of_a_killed_fork_server_end(root, session):
    session.start(SETUP)
    pid, fork_server = session.pid, fork_client.start_fork_server(root)
    os.kill(pid, signal.SIGSTOP)
    os.kill(fork_server._process.pid, signal.SIGKILL)
    assert wait_until(lambda: not process_exists(pid))


@pytest.mark.slow
def test_a_forked_program_starts_its_own_race(root):
    code = f"""
        import os
        from pathlib import Path
        import numpy as np
        from stkzoo.engine.session import WorkerSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        from stkzoo.errors import ApiOrderError
        setup = RaceSetup("olivermath", (KartSetup(is_bot=False),), seed=1)
        controls = np.ones((1, 7), np.float32)
        session = WorkerSession(Path({str(root)!r}))
        session.start(setup)
        child = os.fork()
        if child == 0:
            try:
                session.step(controls)
            except ApiOrderError as error:
                print("child:", "forked" in str(error), flush=True)
            session.start(setup)
            print("child:", session.step(controls).phase, flush=True)
            os._exit(0)
        os.waitpid(child, 0)
        print("parent:", session.step(controls).phase, flush=True)
    """
    assert run_program(code).stdout.split("\n")[:3] == ["child: True", "child: 0", "parent: 0"]


@pytest.mark.slow
def test_the_games_output_stays_off_the_terminal(root):
    code = f"""
        from pathlib import Path
        import numpy as np
        from stkzoo.engine.session import WorkerSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        session = WorkerSession(Path({str(root)!r}))
        session.start(RaceSetup("olivermath", (KartSetup(is_bot=False),)))
        session.step(np.zeros((1, 7), np.float32))
        session.close()
    """
    program = run_program(code)
    assert (program.returncode, program.stdout, program.stderr) == (0, "", "")


@pytest.mark.slow
def test_a_second_race_in_this_process_is_refused_while_the_first_runs(root):
    code = f"""
        from pathlib import Path
        from stkzoo.engine.session import LocalSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        setup = RaceSetup("olivermath", (KartSetup(is_bot=False),))
        first, second = LocalSession(Path({str(root)!r})), LocalSession(Path({str(root)!r}))
        first.start(setup)
        try:
            second.start(setup)
        except Exception as error:
            print(type(error).__name__, "use_subprocess" in str(error))
        first.close()
        print(second.start(setup).snapshot.phase)
    """
    assert run_program(code).stdout.split()[-3:] == ["ApiOrderError", "True", "0"]


@pytest.mark.slow
def test_restarts_in_this_process_leave_no_open_file_and_no_folder(root, tmp_path):
    code = f"""
        import os
        from pathlib import Path
        from stkzoo.engine.session import LocalSession
        from stkzoo.engine.setup import KartSetup, RaceSetup
        session = LocalSession(Path({str(root)!r}))
        for _ in range(3):
            session.start(RaceSetup("olivermath", (KartSetup(is_bot=False),)))
            homes = list(Path({str(tmp_path)!r}).glob("*"))
            print(len(os.listdir("/proc/self/fd")), len(homes))
    """
    done = run_program(code, env={**os.environ, "TMPDIR": str(tmp_path)})
    *_, first, second, third = done.stdout.splitlines()  # the game's own lines come first
    assert first == second == third


def test_a_step_before_the_start_says_reset(root):
    with pytest.raises(ApiOrderError, match="reset"):
        LocalSession(root).step(full_throttle())
    with pytest.raises(ApiOrderError, match="reset"):
        WorkerSession(root).step(full_throttle())
