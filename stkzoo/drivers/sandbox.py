"""Sandboxes for agent processes.

With bubblewrap, an agent has access to Python, its own files and small private folders for
temporary files, but not to the network or to other processes. If bubblewrap does not work, Landlock
restricts access as far as the kernel supports it. A keeper (:mod:`stkzoo.drivers.keeper`) monitors
the agent's processes from outside the sandbox.
"""

from __future__ import annotations

import functools
import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from stkzoo._imports import python_executable, search_path
from stkzoo._temporary import TemporaryFolder
from stkzoo.drivers import confinement
from stkzoo.drivers.files import INSTALLED, AgentPlace
from stkzoo.errors import ConfigError

#: Choices of whether agents run in a sandbox; see :func:`sandbox_kind`.
MODES = ("auto", "on", "off")
BUBBLEWRAP, LANDLOCK, NONE = "bubblewrap", "landlock", "none"

#: Size of each temporary folder in bubblewrap's sandbox [bytes].
TEMPORARY_SIZE = 64 << 20
_PACKAGE = Path(__file__).resolve().parents[1]
#: Paths of the system that programs need.
_SYSTEM = (
    *("/bin", "/lib", "/lib32", "/lib64", "/usr/bin", "/usr/lib", "/usr/lib32", "/usr/lib64"),
    *("/usr/include", "/usr/libexec", "/usr/share", "/usr/local/bin", "/usr/local/lib"),
    *("/nix/store", "/etc/alternatives", "/etc/ld.so.cache", "/etc/localtime"),
)
#: Names in a prefix of Python, which may also be a folder of the user.
_PREFIX = ("bin", "lib", "lib64", "pyvenv.cfg")
#: Packages of stkzoo that are links in a checkout.
_LINKED = ("agents", "wrappers")
#: Paths of the kernel that programs need. Bubblewrap mounts its own.
_KERNEL = ("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/sys/devices/system", "/dev/urandom")
_DEVICES = ("/dev/null",)
#: Files of the kernel about the user's keys, the machine's memory, and timers of all processes.
_HIDDEN = ("/proc/keys", "/proc/kpagecount", "/proc/kpageflags", "/proc/timer_list")
#: Environment variables that agents get. Others may contain secrets.
_VARIABLES = ("PATH", "LANG", "LC_ALL", "LC_CTYPE", "TZ", "LD_LIBRARY_PATH")
#: Environment variable that is set in processes that share the machine with other races.
SHARED_CORES = "STKZOO_SHARED_CORES"
_TRIAL_TIMEOUT = 10.0

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Enclosure:
    """How the process of one agent is started.

    Attributes:
        command: prefix of the agent's command; empty without bubblewrap.
        environment: the agent's environment variables.
        confinement: what the process gives up itself; ``None`` without a sandbox.
    """

    command: Sequence[str] = ()
    environment: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))
    confinement: confinement.Confinement | None = None


def enclose(mode: str, place: AgentPlace, adapter: str | None, resources: ExitStack) -> Enclosure:
    """Returns the sandbox of an agent.

    The agent can read its own files. With an adapter, it can also change them.

    Args:
        mode: one of :data:`MODES`.
        place: how the agent is imported, and where its files are.
        adapter: path of the adapter; ``None`` for none.
        resources: closing it removes the agent's folder for temporary files.

    Raises:
        ConfigError: ``mode`` is ``"on"`` and bubblewrap does not work on this machine.
    """
    sandbox = sandbox_kind(mode)
    if sandbox == NONE:
        return Enclosure()
    paths = [*_SYSTEM, *_python_paths(), *place.paths, *([adapter] if adapter else [])]
    changed = place.paths if adapter else ()  # an adapter's prepare_module_dir may change them
    if sandbox == BUBBLEWRAP:
        home = "/tmp"  # noqa: S108 - inside the sandbox
        command = _bubblewrap_command(paths, changed)
        confined = confinement.Confinement(True)
    else:
        home = str(resources.enter_context(TemporaryFolder("sandbox")).path)
        command = []
        # A package is imported from its own folder. Other modules are searched in these.
        searched = [] if place.package else [place.first, place.last]
        readable, writable = [*paths, *_KERNEL], [home, *changed, *_DEVICES]
        confined = confinement.Confinement(False, readable, writable, searched)
    environment = {name: os.environ[name] for name in _VARIABLES if name in os.environ}
    environment |= {"HOME": home, "TMPDIR": home, "USER": "agent"}
    return Enclosure(command, environment, confined)


def sandbox_kind(mode: str) -> str:
    """Returns the kind of sandbox for agents: ``"bubblewrap"``, ``"landlock"`` or ``"none"``.

    Args:
        mode: ``"on"`` for bubblewrap, ``"auto"`` for the strongest sandbox that works on this
            machine, ``"off"`` for none.

    Raises:
        ConfigError: ``mode`` is ``"on"`` and bubblewrap does not work on this machine.
    """
    if mode == "off":
        return NONE
    if not (problem := bubblewrap_problem()):
        return BUBBLEWRAP
    if mode == "on":
        raise ConfigError(f"there is no sandbox for agents: {problem}; or use --sandbox auto")
    return LANDLOCK if confinement.landlock_version() else NONE


def own_cores(number: int, count: int) -> tuple[int, ...]:
    """Returns the processor cores for one agent of a race; empty for all.

    Each agent gets its own cores if there are enough for all agents and one more for the race. On
    fewer cores, sharing is faster. With two cores and two agents that take 5 ms each, a step took
    6 to 9 ms with shared cores, but 12 ms if both agents ran on one core and the race on the other.

    Args:
        number: number of the agent, from 0.
        count: number of agents.
    """
    if sys.platform != "linux" or SHARED_CORES in os.environ:
        return ()
    cores = sorted(os.sched_getaffinity(0))
    share = (len(cores) - 1) // count
    return tuple(cores[1 + number * share : 1 + (number + 1) * share])


def protections(sandbox: str) -> tuple[str, ...]:
    """Returns the names of the resources that a sandbox protects on this system.

    Args:
        sandbox: its kind, from :func:`sandbox_kind`.
    """
    version = confinement.landlock_version() if sandbox == LANDLOCK else 0
    has_filter = sandbox != NONE and confinement.has_call_filter()
    active = {
        "files": sandbox != NONE,
        "environment variables": sandbox != NONE,
        "tracing": sandbox != NONE,
        "network": sandbox == BUBBLEWRAP or has_filter,
        "TCP": version >= confinement.WITH_TCP,
        "signals": sandbox == BUBBLEWRAP or version >= confinement.WITH_SCOPES,
        "temporary files": sandbox == BUBBLEWRAP,
        "system calls": has_filter,
        "memory and processes of the group": sys.platform == "linux",
    }
    return tuple(name for name, is_active in active.items() if is_active)


@functools.cache
def say_what_is_missing(mode: str) -> None:
    """Logs a warning, once per process and mode, if agents do not get the strongest sandbox.

    Raises:
        ConfigError: see :func:`sandbox_kind`.
    """
    if mode == "off" or (sandbox := sandbox_kind(mode)) == BUBBLEWRAP:
        return
    how = "without a sandbox" if sandbox == NONE else "in a weaker sandbox (Landlock)"
    logger.warning("agents run %s: %s", how, bubblewrap_problem())


@functools.cache
def bubblewrap_problem() -> str:
    """Returns why bubblewrap does not work on this machine and how to fix it; empty if it does."""
    if sys.platform != "linux":
        return "sandboxes need Linux"
    if shutil.which("bwrap") is None:
        return "bubblewrap is not installed; install it (Debian, Ubuntu: apt install bubblewrap)"
    prefix = _bubblewrap_command([*_SYSTEM, *_python_paths()])
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter
            [*prefix, python_executable(), "-I", "-S", "-c", ""],
            capture_output=True,
            text=True,
            timeout=_TRIAL_TIMEOUT,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"bubblewrap does not work: {error}"
    if done.returncode == 0:
        return ""
    said = (done.stderr.strip().splitlines() or ["no message"])[-1]
    return f"bubblewrap does not work here ({said[:100]}); it needs version 0.8 and user namespaces"


def _bubblewrap_command(paths: Sequence[str], writable: Sequence[str] = ()) -> list[str]:
    """Returns the prefix of a command that runs it with access to these paths only."""
    temporary = ["--size", str(TEMPORARY_SIZE), "--tmpfs"]
    command = [
        *(shutil.which("bwrap") or "bwrap", "--unshare-all", "--unshare-user", "--disable-userns"),
        *("--die-with-parent", "--cap-drop", "ALL", "--dev", "/dev", "--proc", "/proc"),
        *(*temporary, "/tmp", *temporary, "/dev/shm"),  # noqa: S108 - inside the sandbox
        *("--tmpfs", "/dev/pts"),  # the number of terminals of all users is limited
        # A mapping of /dev/zero is shared memory, which is not counted. /dev/full reads as zeros
        # too, but cannot be mapped.
        *("--dev-bind", "/dev/full", "/dev/zero"),
    ]
    mounted: set[str] = set()
    for path in (place(path) for path in paths for place in (os.path.abspath, os.path.realpath)):
        if path in writable or not mounted & {path, *map(str, Path(path).parents)}:
            command += ["--bind" if path in writable else "--ro-bind-try", path, path]
            mounted.add(path)
    for path in filter(os.path.exists, _HIDDEN):
        command += ["--ro-bind", "/dev/null", path]
    for place in ("/proc", "/dev/pts", "/dev", "/"):  # root could change kernel settings in /proc
        command += ["--remount-ro", place]
    return [*command, "--"]


def _python_paths() -> Iterator[str]:
    """Yields the paths of Python, installed packages, their libraries and stkzoo.

    Other folders of the search path, such as those of editable installations, are not among them:
    they contain files of the user.
    """
    for prefix in dict.fromkeys((sys.prefix, sys.base_prefix, sys.exec_prefix)):
        yield from (os.path.join(prefix, name) for name in _PREFIX)
    yield from (path for path in search_path() if Path(os.path.realpath(path)).name in INSTALLED)
    yield str(_PACKAGE)
    yield from (str(_PACKAGE / name) for name in _LINKED)
    for folder in filter(os.path.isabs, os.environ.get("LD_LIBRARY_PATH", "").split(":")):
        yield from map(str, Path(folder).glob("*.so*"))
    interpreter = python_executable()
    yield interpreter
    while os.path.islink(interpreter):  # a link may lead through a folder outside of the prefixes
        interpreter = os.path.join(os.path.dirname(interpreter), os.readlink(interpreter))
        yield interpreter
