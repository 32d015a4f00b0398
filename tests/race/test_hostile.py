"""Agents that attack the machine, the race and each other, with and without a sandbox."""

import os
import re
import shutil
import socket
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from stkzoo._temporary import remove_stale_folders
from stkzoo.drivers import confinement, sandbox
from stkzoo.drivers.confinement import has_call_filter
from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from tests.support.adversaries import (
    ADVERSARIES,
    left_behind,
    problems_of,
    race_with,
    write_adversary,
    write_quitter,
)
from tests.support.paths import AGENTS
from tests.support.processes import wait_until

pytestmark = pytest.mark.slow

SECRET = "the key of the house"

#: An attack succeeds if its expression is true, and fails if it is false or raises.
PROBES = {
    "signal the race": "os.kill(RACE, 0) is None",
    "stop the race": "os.kill(RACE, signal.SIGCONT) is None",
    "signal its keeper": "os.getppid() > 2 and os.kill(os.getppid(), 0) is None",
    "signal a rival": "any(os.kill(pid, 0) is None for pid in others())",
    "see other processes": "bool(others())",
    "read the race's environment": "SECRET in open(f'/proc/{RACE}/environ').read()",
    "open the race's memory": "bool(open(f'/proc/{RACE}/mem', 'rb'))",
    "read the race's memory": "read_memory(RACE) > 0",
    "trace the race": "call(ptrace, 0x4206, RACE, 0, 0) == 0",
    "take the race's descriptors": "call(438, call(434, RACE, 0), 0, 0) >= 0",
    "read its own environment": "'STKZOO_TEST_SECRET' in os.environ",
    "read a file": "SECRET in open(HOME + '/secret').read()",
    "read a rival's file": "SECRET in open(HOME + '/rival/notes.txt').read()",
    "read through a link": "SECRET in open(module_dir / 'link').read()",
    "list the user's folder": "bool(os.listdir(HOME + '/secrets'))",
    "write a file": "open(HOME + '/written', 'w').write('x') == 1",
    "change itself": "(module_dir / 'more.py').write_text('x') == 1",
    "change stkzoo": "bool(os.open(stkzoo.__file__, os.O_WRONLY))",
    "change the installed packages": "bool(os.open(numpy.__file__, os.O_WRONLY))",
    "change the kernel's settings": "bool(os.open('/proc/sys/kernel/core_pattern', os.O_WRONLY))",
    "read the user's keys": "bool(open('/proc/keys').read())",
    "read the machine's memory pages": "bool(open('/proc/kpageflags', 'rb').read(8))",
    "leave a temporary file": "open('/tmp/' + MARK, 'w').write('x') and os.path.exists('/tmp')",
    "leave shared memory": "open('/dev/shm/' + MARK, 'w').write('x') == 1",
    "fill the disk": "fill(os.environ.get('TMPDIR', '/tmp')) > 64",
    "connect": "bool(socket.create_connection(('127.0.0.1', PORT), 1))",
    "listen": "socket.create_server(('127.0.0.1', 0)) and PORT in ports()",
    "send a packet": "datagram()",
    "reach a local socket": "local(HOME + '/socket')",
    "reach an abstract socket": "local(chr(0) + MARK)",
    "make namespaces": "call(unshare, 0x10000000) == 0 and os.getuid() != UID",
    "become another user": "UID != 0 and os.setuid(0) is None",
    "take priority": "os.nice(-5) < 0",
    "log to the kernel": "bool(os.open('/dev/kmsg', os.O_WRONLY))",
    "trace itself": "call(ptrace, 0, 0, 0, 0) == 0",
    "use io_uring": "call(425, 1, ctypes.create_string_buffer(256)) >= 0",
    "join a keyring": "call(keyctl, 1, 0) >= 0",
    "hide memory in System V segments": "call(shmget, 0, 1 << 20, 0o1600) >= 0",
    "hide memory in message queues": "call(mq_open, b'stkzoo', 0o102, 0o600, 0) >= 0",
    "change the race's limits": "resource.prlimit(RACE, 7, resource.prlimit(RACE, 7)) is not None",
    "change the race's priority": "os.setpriority(0, RACE, os.getpriority(0, RACE)) is None",
    "change the priority of its user": "reaches(os.setpriority, os.PRIO_USER, 1 << 30, 0)",
    "change the race's scheduling": (
        "os.sched_setscheduler(RACE, os.sched_getscheduler(RACE), os.sched_param(0)) is None"
    ),
    "change the race's scheduling parameter": "os.sched_setparam(RACE, os.sched_param(0)) is None",
    "change the race's scheduling attributes": "call(sched_setattr, RACE, bytes(48), 0) == 0",
    "change the race's disk priority": "call(ioprio_set, 1, RACE, 0) == 0",
    "hide memory in unmapped pages": "mmap.mmap(-1, 1 << 20) is not None",
    "hide memory in a mapped device": "map_device() is not None",
    "hide memory in anonymous files": "os.memfd_create('x') >= 0",
    "hide memory from the kernel": "call(447, 0) >= 0",
    "hide memory in pipes": "reaches(call, vmsplice, os.pipe()[1], 0, 0, 0)",
    "hide memory in messages": "zero_copy(60)",
    "hide memory in messages by another number": "zero_copy(60 | 1 << 32)",
    "take other cores": "os.sched_setaffinity(0, range(os.cpu_count())) is None",
    "reach the host of a virtual machine": "socket.socket(40, 1) is not None",
    "reach the host by another number": "reaches(call, socket_, 40 | 1 << 32, 1, 0)",
    "use the kernel's cryptography": "socket.socket(38, 5) is not None",
    "leave its session": "leave_session()",
    "open many files": "bool([open('/dev/null') for _ in range(5000)])",
    "raise its limits": "resource.setrlimit(resource.RLIMIT_NOFILE, (1 << 20,) * 2) is None",
    "write a large file": "write_large(os.environ.get('TMPDIR', '/tmp')) > 0",
    "get capabilities": "int(status('CapEff'), 16) or int(status('CapPrm'), 16)",
    "get new privileges": "status('NoNewPrivs') == '0'",
    "dump its memory": "resource.getrlimit(resource.RLIMIT_CORE)[1] != 0",
    "lease a shared file": "command_of_file(fcntl.F_SETLEASE, fcntl.F_WRLCK) == 0",
    "lock a shared file": "fcntl.flock(open(numpy.__file__), fcntl.LOCK_EX) is None",
    "lock a part of a shared file": "fcntl.lockf(open(numpy.__file__), fcntl.LOCK_SH) is None",
    "lock a description of a shared file": "bool(command_of_file(37, bytes(32)))",
    "be notified by a folder": "fcntl.fcntl(os.open('/usr/lib', 0), fcntl.F_NOTIFY, 1) == 0",
    "be notified of shared files": "libc.inotify_init1(0) >= 0",
    "be notified of all files": "reaches(call, fanotify_init, 0x200, 0)",
    "get signals from a file": "command_of_file(fcntl.F_SETOWN, os.getpid()) == 0",
    "read flags of a shared file": "bool(fcntl.ioctl(open(numpy.__file__), 0x80086601, bytes(8)))",
    "change the mode of a file": "changes(lambda mode: os.chmod(HOME + '/secret', mode ^ 1))",
    "change the times of a file": "changes(lambda _: os.utime(HOME + '/secret', (1, 1)))",
    "add attributes to a file": "os.setxattr(HOME + '/secret', 'user.mark', b'x') is None",
    "use up timers": "libc.timer_create(0, None, ctypes.byref(ctypes.c_void_p())) == 0",
    "use up descriptors in flight": "in_flight() > 512",
    "use up pending signals": "pending() > 64",
    "use up watches of events": "select.epoll() is not None",
    "use up asynchronous requests": "reaches(call, io_setup, 1 << 30, 0)",
    "use up locked memory": "libc.mlock(ctypes.create_string_buffer(8192), 8192) == 0",
    "use up huge pages": "reaches(mmap.mmap, -1, 2 << 20, 0x40022)",
    "use up terminals": "os.openpty() is not None",
    "use up large pipes": "fcntl.fcntl(os.pipe()[0], 1031, 1 << 20) > 0",
    "use up named pipes": "os.mkfifo(os.environ.get('TMPDIR', '/tmp') + '/' + MARK + 'p') is None",
    "take real-time priority": "os.sched_setscheduler(0, 1, os.sched_param(1)) is None",
    "hide its files from its keeper": "libc.prctl(4, 0, 0, 0, 0) == 0",
    "adopt orphans": "libc.prctl(36, 1, 0, 0, 0) == 0",
}

#: Attacks that succeed in the weaker sandbox with kernel 6.12.
LANDLOCK_ALLOWS = {"reach a local socket", "fill the disk"}
#: Attacks that succeed inside bubblewrap's sandbox, but whose effects end with it.
INSIDE = {"leave a temporary file", "leave shared memory", "write a file"}
#: Attacks that, without a sandbox, would stop the test or have effects after it.
HARMFUL = {
    *("trace the race", "trace itself"),
    *("hide memory in System V segments", "hide memory in message queues"),
    *("change the race's scheduling attributes", "change the race's disk priority"),
    *("lease a shared file", "use up descriptors in flight", "use up named pipes"),
}
#: Attacks that always succeed without a sandbox.
ALWAYS = {
    *("signal the race", "read a file", "read a rival's file", "write a file", "change itself"),
    *("connect", "read its own environment", "leave shared memory", "see other processes"),
    *("leave its session", "take other cores", "join a keyring"),
    *("change the race's limits", "change the race's priority", "change the race's scheduling"),
    *("hide memory in unmapped pages", "hide memory in anonymous files", "hide memory in pipes"),
    *("hide memory in a mapped device", "hide memory in messages"),
    *("lock a shared file", "lock a part of a shared file", "lock a description of a shared file"),
    *("be notified by a folder", "be notified of shared files", "get signals from a file"),
    *("change the mode of a file", "change the times of a file", "hide its files from its keeper"),
    *("use up timers", "use up pending signals", "use up watches of events"),
    *("use up asynchronous requests", "use up huge pages", "use up terminals"),
}

PRELUDE = """
import array, ctypes, errno, fcntl, mmap, os, platform, resource, select, signal, socket, struct
import sys, time
import numpy, stkzoo

RACE, PORT, HOME, MARK, SECRET, UID = {values}
libc = ctypes.CDLL(None, use_errno=True)
ptrace, process_vm_readv, unshare, keyctl, shmget, mq_open = (
    (101, 310, 272, 250, 29, 240)
    if platform.machine() == "x86_64"
    else (117, 270, 97, 219, 194, 180)
)
sched_setattr, ioprio_set, vmsplice, socket_, setsockopt = (
    (314, 251, 278, 41, 54) if platform.machine() == "x86_64" else (274, 30, 75, 198, 208)
)
fanotify_init, io_setup = (300, 206) if platform.machine() == "x86_64" else (262, 0)

def wide(argument):
    return ctypes.c_long(argument) if isinstance(argument, int) else argument

def call(number, *arguments):
    result = libc.syscall(number, *map(wide, arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
    return result

# Whether the kernel gets a call, which it may still find invalid.
def reaches(function, *arguments):
    try:
        function(*arguments)
    except OSError as error:
        return error.errno not in (errno.EPERM, errno.ENOSYS)
    return True

def command_of_file(command, argument):
    with open(numpy.__file__) as file:
        return fcntl.fcntl(file, command, argument)

# Whether a function changes a secret file. It may only pretend to.
def changes(function):
    before = os.stat(HOME + "/secret")
    function(before.st_mode)
    return os.stat(HOME + "/secret") != before

def in_flight():
    pairs = [socket.socketpair() for _ in range(8)]
    files = socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [1] * 253)
    sent = 0
    try:
        for one, other in pairs:
            one.sendmsg([b"x"], [files])
            sent += 253
    except OSError:
        pass
    return sent

def pending():
    signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGRTMIN + 5])
    return sum(libc.sigqueue(os.getpid(), signal.SIGRTMIN + 5, None) == 0 for _ in range(200))

def map_device():
    with open("/dev/zero", "r+b", 0) as file:
        return mmap.mmap(file.fileno(), 4096)

def zero_copy(option):
    with socket.socket(socket.AF_INET) as out:
        one = ctypes.byref(ctypes.c_int(1))
        return call(setsockopt, out.fileno(), 1, option, one, 4) == 0

def others():
    mine = (os.getpid(), os.getppid())
    pids = [int(name) for name in os.listdir("/proc") if name.isdigit()]
    return [pid for pid in pids if pid not in mine and "drivers" in command(pid)]

def command(pid):
    try:
        return open("/proc/%d/cmdline" % pid).read()
    except OSError:
        return ""

def read_memory(pid):
    place = id(libc) & ~4095
    buffer = ctypes.create_string_buffer(8)
    here = struct.pack("PN", ctypes.addressof(buffer), 8)
    there = struct.pack("PN", ctypes.addressof(buffer), 8)
    maps = [line.split() for line in open("/proc/%d/maps" % pid)]
    start = next(int(line[0].split("-")[0], 16) for line in maps if line[1].startswith("rw"))
    return call(process_vm_readv, pid, here, 1, struct.pack("PN", start, 8), 1, 0)

def fill(folder):
    with open(os.path.join(folder, MARK + "fill"), "wb") as file:
        try:
            for _ in range(100):
                file.write(bytes(1 << 20))
        finally:
            os.unlink(file.name)
    return 100

def write_large(folder):
    path = os.path.join(folder, MARK + "large")
    try:
        with open(path, "wb") as file:
            return file.truncate(65 << 20)
    finally:
        os.unlink(path)

def leave_session():
    child = os.fork()
    if child == 0:
        os.setsid()
        os._exit(os.getsid(0) != os.getpid())
    return os.waitpid(child, 0)[1] == 0

def status(name):
    lines = [line.split() for line in open("/proc/self/status")]
    return next(line[1] for line in lines if line and line[0] == name + ":")

def datagram():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        return out.sendto(MARK.encode(), ("127.0.0.1", PORT)) > 0

def ports():
    return [int(line.split()[1].split(":")[1], 16) for line in list(open("/proc/net/tcp"))[1:]]

def local(place):
    with socket.socket(socket.AF_UNIX) as out:
        out.connect(place)
    return True
"""

REPORTER = """
PROBES = {probes!r}

def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        reached, why = [], []
        for name, attack in PROBES.items():
            try:
                if eval(attack, globals() | {{"module_dir": module_dir}}):
                    reached.append(name)
            except Exception as error:
                why.append(name + ": " + str(error))
        raise RuntimeError("|".join(["reached", *reached]))
    return actor
"""

#: Attacks that the page on the threat model names.
ON_THE_PAGE = (
    *("kills everyone", "kills its parent", "stops its parent"),
    *("shares memory", "hides memory", "spreads memory", "fills page tables"),
    *("fills its folders", "writes sparse files", "makes many files"),
    *("leaves daemons", "leaves finalizers"),
)
OTHERS = [name for name in ADVERSARIES if name not in ON_THE_PAGE]

FORK_BOMB = """
def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        while True:
            os.fork()
    return actor
"""


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """Makes a folder with secrets, a rival and sockets, and a function that writes agents."""
    shutil.copytree(AGENTS / "plain", tmp_path / "rival")
    for name in ("secret", "rival/notes.txt", "secrets/one"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(SECRET)
    monkeypatch.setenv("STKZOO_TEST_SECRET", SECRET)
    mark = f"stkzoo-test-{os.getpid()}"
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as packets,
        socket.socket(socket.AF_UNIX) as named,
        socket.socket(socket.AF_UNIX) as abstract,
    ):
        named.bind(str(tmp_path / "socket"))
        abstract.bind(f"\0{mark}")
        named.listen()
        abstract.listen()
        port = server.getsockname()[1]
        packets.bind(("127.0.0.1", port))
        packets.setblocking(False)
        values = (os.getpid(), port, str(tmp_path), mark, SECRET, os.getuid())

        def write(name, code):
            folder = tmp_path / name.replace(" ", "_")
            folder.mkdir()
            (folder / "pystk_actor.py").write_text(PRELUDE.format(values=values) + code)
            (folder / "link").symlink_to(tmp_path / "secret")
            return f"{folder}@:{name}"

        yield tmp_path, mark, write, packets
    for folder in ("/tmp", "/dev/shm"):
        Path(folder, mark).unlink(missing_ok=True)


def race(*drivers, **settings):
    settings = {"action_timeout": 5.0, "agent_memory": 400, "max_steps": 30, **settings}
    return run_race(list(drivers), track="lighthouse", seed=1, **settings)


def by_driver(result):
    return {row.driver: row for row in result.agents}


def reached_in(result):
    said = by_driver(result)["spy"].errors[0].message
    assert "RuntimeError: reached" in said, said
    return {*said.split("|")[1:]}


needs_bubblewrap = pytest.mark.skipif(
    bool(sandbox.bubblewrap_problem()), reason=sandbox.bubblewrap_problem()
)
needs_seccomp = pytest.mark.skipif(not has_call_filter(), reason="needs libseccomp")
needs_landlock = pytest.mark.skipif(
    confinement.landlock_version() < 6, reason="needs Landlock's version 6"
)


@needs_seccomp
@needs_bubblewrap
def test_bubblewrap_confines_an_agent(bench):
    home, mark, write, packets = bench
    spy = write("spy", REPORTER.format(probes=PROBES))
    result = race(str(home / "rival"), spy, sandbox="on")
    assert result.sandbox == "bubblewrap"
    assert {"files", "network", "signals", "tracing"} <= {*result.protections}
    assert reached_in(result) <= INSIDE
    places = (home / "written", Path("/tmp", mark), Path("/dev/shm", mark))
    assert not any(place.exists() for place in places)
    with pytest.raises(BlockingIOError):
        packets.recv(100)
    assert not by_driver(result)["Plain"].num_errors


@needs_seccomp
@needs_landlock
def test_landlock_confines_an_agent(bench, monkeypatch):
    home, _, write, _ = bench
    monkeypatch.setattr(sandbox, "bubblewrap_problem", lambda: "a test")
    sandbox.say_what_is_missing.cache_clear()
    spy = write("spy", REPORTER.format(probes=PROBES))
    result = race(str(home / "rival"), spy)
    assert result.sandbox == "landlock"
    assert "temporary files" not in result.protections
    assert reached_in(result) <= LANDLOCK_ALLOWS
    sandbox.say_what_is_missing.cache_clear()


LISTER = """
import os

def get_actor(module_dir, observation_space, action_space):
    raise RuntimeError("|".join(os.listdir({home!r})))
"""


@needs_landlock
@pytest.mark.parametrize(("file", "can_list"), [("__init__.py", False), ("../spy.py", True)])
def test_landlock_lets_only_an_agent_that_is_a_single_file_list_its_folder(
    tmp_path, monkeypatch, file, can_list
):
    monkeypatch.setattr(sandbox, "bubblewrap_problem", lambda: "a test")
    (tmp_path / "spy").mkdir()
    path = tmp_path / "spy" / file
    path.write_text(LISTER.format(home=str(tmp_path)))
    agent = path.parent if path.name == "__init__.py" else path
    message = race(f"{agent.resolve()}@:spy").agents[0].errors[0].message
    assert message.startswith("RuntimeError: spy" if can_list else "PermissionError"), message


NESTS = """
def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        os.chdir({place})
        for _ in range(1200):
            os.mkdir("x")
            os.chdir("x")
        1 / 0
    return actor
"""


@pytest.fixture
def own_temporary_folder(tmp_path_factory, monkeypatch):
    """Makes a folder for the race's temporary folders."""
    folder = tmp_path_factory.mktemp("temporary")
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    yield folder
    subprocess.run(["rm", "-rf", folder], check=True)  # pytest cannot remove nested folders


def agent_folders(folder):
    """Returns the temporary folders of agents; those of the game's processes exist longer."""
    return [*folder.glob("*/sandbox-*"), *folder.glob("*/agent-*")]


@needs_landlock
def test_an_agent_that_nests_thousands_of_temporary_folders_affects_only_its_kart(
    bench, own_temporary_folder, monkeypatch
):
    home, _, write, _ = bench
    monkeypatch.setattr(sandbox, "bubblewrap_problem", lambda: "a test")
    nests = write("nests", NESTS.format(place='os.environ["TMPDIR"]'))
    result = race(str(home / "rival"), nests, max_steps=5, action_timeout=60.0)
    assert "ZeroDivisionError" in by_driver(result)["nests"].errors[0].message
    assert not by_driver(result)["Plain"].num_errors
    assert agent_folders(own_temporary_folder) == []


WRITES = """
def get_actor(module_dir, observation_space, action_space):
    for name in "abc":
        (module_dir / name).write_bytes(bytes(30 << 20))
    return lambda state, observation: action_space.sample()
"""


@needs_bubblewrap
def test_an_agent_with_an_adapter_can_leave_many_files_in_its_folder(bench):
    home, _, write, _ = bench
    (home / "adapter.py").write_text("def create_actor(get, *given):\n    return get(*given)\n")
    settings = {"adapter": str(home / "adapter.py"), "sandbox": "on", "action_timeout": 60.0}
    result = race(write("writes", WRITES), max_steps=2, **settings)
    assert not result.agents[0].num_errors
    assert sum((home / "writes" / name).stat().st_size for name in "abc") == 90 << 20


ORACLE = """
def get_actor(module_dir, observation_space, action_space):
    raise RuntimeError(f"seed {numpy.random.get_state()[1][0]}")
"""


def test_an_agent_learns_the_seed_of_its_race(bench):
    write = bench[2]
    result = race("ai", write("oracle", ORACLE))  # the agent drives kart_1
    assert by_driver(result)["oracle"].errors[0].message == "RuntimeError: seed 2"


SLEEPS = """
def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        open(os.environ["TMPDIR"] + "/races", "w").close()
        time.sleep(600)
    return actor
"""


@needs_landlock
def test_the_next_race_removes_the_temporary_folder_of_an_agent_whose_race_was_killed(
    bench, own_temporary_folder
):
    write = bench[2]
    code = f"""
        from stkzoo.drivers import sandbox
        from stkzoo.race import run_race
        sandbox.bubblewrap_problem = lambda: "a test"
        run_race([{write("sleeps", SLEEPS)!r}], track="lighthouse", action_timeout=None)
    """
    program = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "TMPDIR": str(own_temporary_folder)},
    )
    try:
        assert wait_until(lambda: [*own_temporary_folder.glob("*/*/races")], 60)
    finally:
        program.kill()
        program.wait()
    assert wait_until(lambda: _removed(own_temporary_folder))


def _removed(folder):
    remove_stale_folders()
    return not agent_folders(folder)


@pytest.mark.parametrize("command", ["race", "tournament"])
def test_a_command_in_an_agents_folder_runs_no_file_of_it_by_the_name_of_a_python_module(
    command, tmp_path
):
    folder, proof = tmp_path / "agent", tmp_path / "proof"
    shutil.copytree(AGENTS / "plain", folder)
    for name in ("json", "types"):
        (folder / f"{name}.py").write_text(f"open({str(proof)!r}, 'w').write('ran')")
    program = tmp_path / "program.py"  # like the command, it searches its own folder
    program.write_text("import sys, stkzoo.cli; sys.exit(stkzoo.cli.main())")
    words = [command, ".", "ai", "--track", "lighthouse", "--max-steps", "3", "--sandbox", "off"]
    words += ["--output", str(tmp_path / "result")]
    words += ["--races", "2"] if command == "tournament" else []
    done = subprocess.run(
        [sys.executable, str(program), *words], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert not proof.exists()


def test_an_agent_without_a_sandbox_is_not_confined(bench):
    home, _, write, _ = bench
    harmless = {name: probe for name, probe in PROBES.items() if name not in HARMFUL}
    spy = write("spy", REPORTER.format(probes=harmless))
    result = race(str(home / "rival"), spy, sandbox="off")
    assert result.sandbox == "none"
    assert not {"files", "network", "signals", "system calls"} & {*result.protections}
    assert reached_in(result) >= ALWAYS


@needs_bubblewrap
@pytest.mark.parametrize(
    "names",
    [ON_THE_PAGE, pytest.param(OTHERS, marks=pytest.mark.matrix)],
    ids=["on the page", "others"],
)
def test_attacks_affect_only_their_own_karts(tmp_path, names):
    """Runs many attacks at once beside two drivers."""
    mark = f"stkzoo-test-{os.getpid()}"
    quiet = race_with(*(write_quitter(tmp_path, name) for name in names))
    before = left_behind(mark)
    result = race_with(*(write_adversary(tmp_path, name, mark) for name in names))
    assert problems_of(result, quiet) == []
    assert wait_until(lambda: left_behind(mark) == before)


@needs_bubblewrap
def test_a_fork_bomb_is_stopped(bench):
    """It slows down all karts until it is ended, so no other attack races beside it.

    On a busy machine its time limit may end it before its processes are counted.
    """
    home, mark, write, _ = bench
    bomb = write("bomb", FORK_BOMB)
    result = race(str(home / "rival"), bomb, sandbox="on", action_timeout=30.0)
    assert not by_driver(result)["Plain"].num_errors
    message = by_driver(result)["bomb"].errors[0].message
    reasons = "more than 128 processes|with all its processes|temporarily|longer than 30 s"
    assert re.search(reasons, message)
    assert wait_until(lambda: not named(mark), seconds=30.0)


def named(mark):
    """Returns the processes that have the mark in their command line."""
    lines = [folder / "cmdline" for folder in Path("/proc").glob("[0-9]*")]
    return [line for line in lines if mark in _text(line)]


def _text(file):
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""


def test_a_race_is_refused_if_its_sandbox_is_unavailable(monkeypatch):
    monkeypatch.setattr(sandbox, "bubblewrap_problem", lambda: "bubblewrap is not installed")
    with pytest.raises(ConfigError, match="no sandbox for agents: bubblewrap is not installed"):
        race(str(AGENTS / "plain"), sandbox="on")
    assert race("ai", sandbox="on").sandbox is None  # the game's AI needs none


def test_a_missing_sandbox_is_logged_once(monkeypatch, caplog):
    monkeypatch.setattr(sandbox, "bubblewrap_problem", lambda: "bubblewrap is not installed")
    monkeypatch.setattr(confinement, "landlock_version", lambda: 0)
    sandbox.say_what_is_missing.cache_clear()
    for _ in range(2):
        assert race(str(AGENTS / "plain"), max_steps=3).sandbox == "none"
    told = [record.getMessage() for record in caplog.records]
    assert told == ["agents run without a sandbox: bubblewrap is not installed"]
    sandbox.say_what_is_missing.cache_clear()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sandbox": "yes"}, "unknown sandbox 'yes'. Known: auto, off, on"),
        ({"sandbox": "on", "inline": True}, "agents run inline; leave out one of the two"),
    ],
)
def test_an_invalid_sandbox_is_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        race("ai", **settings)


SPINNER = """
import json

def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        try:
            os.sched_setaffinity(0, range(os.cpu_count()))
        except OSError:
            pass
        raise RuntimeError(json.dumps(sorted(os.sched_getaffinity(0))))
    return actor
"""


def test_each_agent_has_its_own_cores_if_there_are_enough(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {*range(8)})
    assert [sandbox.own_cores(number, 3) for number in range(3)] == [(1, 2), (3, 4), (5, 6)]
    assert sandbox.own_cores(0, 8) == ()


@needs_seccomp
@needs_bubblewrap
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_a_sandboxed_agent_stays_on_its_cores(bench):
    _, _, write, _ = bench
    result = race(write("spinner", SPINNER), "ai", sandbox="on")
    message = by_driver(result)["spinner"].errors[0].message
    allowed = str(sorted(os.sched_getaffinity(0))[1:])
    assert message == f"RuntimeError: {allowed}"
    assert "cores" in result.protections
