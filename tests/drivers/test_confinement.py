"""The filter of system calls on each processor, as the kernel reads it."""

import ctypes
import errno
import os
import struct

import pytest

from stkzoo.drivers import confinement

pytestmark = pytest.mark.skipif(not confinement.has_call_filter(), reason="needs libseccomp")

#: Architectures of the kernel, by the name that libseccomp uses.
ARCHITECTURES = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
ALLOWED, PRETENDED, REFUSED = 0x7FFF0000, 0x50000, 0x50000 | errno.ENOSYS
#: Calls that Python, numpy and torch make.
NEEDED = [
    *(("openat",), ("read",), ("futex",), ("execve",), ("exit_group",), ("rt_sigreturn",)),
    *(("mmap", 0, 4096, 3, 0x22), ("mmap", 0, 4096, 3, 0x4022), ("mmap", 0, 4096, 1, 0x1)),
    *(("clone", 0x3D0F00), ("clone", 0x1200011), ("prlimit64", 0, 7), ("wait4",), ("ppoll",)),
    *(("fcntl", 3, 1), ("fcntl", 3, 1030), ("fcntl", 3, 1030 | 1 << 32), ("ioctl", 1, 0x5401)),
    *(("prctl", 15), ("socket", 1, 1), ("socketpair", 1, 1), ("sendmsg",), ("getrandom",)),
    *(("setpriority", 0, 0), ("setsockopt", 3, 1, 2), ("kill",), ("sched_getaffinity",)),
]
FORBIDDEN = [
    *(
        ("flock",),
        *(("fcntl", 3, command) for command in (5, 6, 7, 8, 10, 37, 38, 1024, 1026, 1031)),
    ),
    *(("ioctl", 3, command) for command in (0x40086602, 0x40806685, 0x5412, 0x541C, 0xC0045877)),
    *(("inotify_init1",), ("fanotify_init",), ("epoll_create1",), ("timer_create",)),
    *(("timerfd_create",), ("rt_sigqueueinfo",), ("mq_open",), ("keyctl",), ("add_key",)),
    *(("io_setup",), ("io_uring_setup",), ("bpf",), ("perf_event_open",), ("userfaultfd",)),
    *(("mmap", 0, 4096, 3, 0x21), ("mmap", 0, 4096, 3, 0x40022), ("mmap", 0, 4096, 3, 0x2022)),
    *(("mlock",), ("memfd_create",), ("memfd_secret",), ("vmsplice",), ("splice",), ("shmget",)),
    *(("clone", 1 << bit) for bit in (7, 17, 25, 26, 27, 28, 29, 30)),
    *(("clone3",), ("unshare",), ("setns",), ("mount",), ("chroot",), ("ptrace",), ("kcmp",)),
    *(("socket", family) for family in (2, 10, 16, 17, 38, 40, 40 | 1 << 32)),
    *(("setsockopt", 3, 1, 60), ("setsockopt", 3, 1, 26), ("setsockopt", 3, 1, 60 | 1 << 32)),
    *(("prctl", option) for option in (4, 22, 36, 62, 0x59616D61)),
    *(("prlimit64", 1, 7), ("setpriority", 2, 0), ("setpriority", 0, 1), ("sched_setaffinity",)),
    *(("sched_setscheduler",), ("ioprio_set",), ("pidfd_open",), ("seccomp",), ("setxattr",)),
    *(("mknodat",), ("sync",), ("swapon",), ("reboot",), ("open_by_handle_at",)),
]


class Library:
    """libseccomp, which writes the filter of any architecture to a file instead of loading it."""

    def __init__(self, real, architecture, file):
        self.real, self.token, self.file = real, ARCHITECTURES[architecture], file

    def __getattr__(self, name):
        return getattr(self.real, name)

    def seccomp_init(self, action):
        context = ctypes.c_void_p(self.real.seccomp_init(action))
        if self.real.seccomp_arch_exist(context, self.token):
            self.real.seccomp_arch_add(context, self.token)
            self.real.seccomp_arch_remove(context, 0)
        return context

    def seccomp_load(self, context):
        return self.real.seccomp_export_bpf(context, self.file.fileno())


def run(program, data):
    """Returns the result of a filter: an interpreter of the instructions that filters use."""
    accumulator = position = 0
    while True:
        code, if_true, if_false, value = program[position]
        position += 1
        if code == 0x20:
            (accumulator,) = struct.unpack_from("<I", data, value)
        elif code == 0x54:
            accumulator &= value
        elif code == 0x05:
            position += value
        elif code in (0x15, 0x25, 0x35):
            is_equal, is_more = accumulator == value, accumulator > value
            is_true = {0x15: is_equal, 0x25: is_more, 0x35: is_equal or is_more}[code]
            position += if_true if is_true else if_false
        else:
            assert code == 0x06, f"an instruction {code:#x}"
            return value


@pytest.fixture(params=ARCHITECTURES)
def result_of(request, monkeypatch, tmp_path):
    """Returns a function that gives the filter's result for a call with these arguments."""
    filters = {}
    with (tmp_path / "filter").open("w+b") as file:
        library = Library(confinement._library(), request.param, file)
        monkeypatch.setattr(confinement, "_library", lambda: library)
        for has_own_mounts in (True, False):
            os.truncate(file.fileno(), 0)
            file.seek(0)
            confinement.restrict_calls(has_own_mounts=has_own_mounts)
            file.seek(0)
            filters[has_own_mounts] = [*struct.iter_unpack("<HBBI", file.read())]

    def result(name, *arguments, has_own_mounts=False):
        number = library.seccomp_syscall_resolve_name_arch(library.token, name.encode())
        values = [*arguments, *[0] * (6 - len(arguments))]
        data = struct.pack("<iIQ6Q", number, library.token, 0, *values)
        return run(filters[has_own_mounts], data)

    return result


def test_an_agent_can_make_the_calls_that_it_needs_and_no_others(result_of):
    assert [call for call in NEEDED if result_of(*call) != ALLOWED] == []
    assert [call for call in FORBIDDEN if result_of(*call) != REFUSED] == []


def test_an_agent_changes_attributes_of_files_only_if_mounts_protect_the_users(result_of):
    for name in ("fchmodat", "fchownat", "utimensat"):
        assert result_of(name, has_own_mounts=True) == ALLOWED
        assert result_of(name, has_own_mounts=False) == PRETENDED
