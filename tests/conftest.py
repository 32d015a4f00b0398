"""Settings for the whole test run."""

import os
import signal
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
#: Folders and files in which all tests are slow; elsewhere, slow tests are marked individually.
SLOW = (
    "benchmarks",
    "chaos",
    "compat/test_compat.py",
    "docs/test_agents_page.py",
    "docs/test_examples.py",
    "docs/test_tutorials.py",
    "env/test_all_tracks.py",
    "env/test_determinism.py",
    "packaging/test_packaging.py",
    "parity",
    "race/remote/test_hostile.py",
)

# The test processes share the cores, and small networks are faster on one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # inherited, for example after `make test &`
    signal.signal(signal.SIGINT, signal.default_int_handler)

#: Fixtures that run whole races or training, which makes their tests slow.
SLOW_FIXTURES = {"imitated", "small", "whole"}


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Returns one worker for each core that this program may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count()


def pytest_collection_modifyitems(items):
    """Marks the tests of slow folders and fixtures, which ``make test-fast`` skips."""
    for item in items:
        name = item.path.as_posix().removeprefix(f"{TESTS.as_posix()}/")
        if name.startswith(SLOW) or SLOW_FIXTURES & {*getattr(item, "fixturenames", ())}:
            item.add_marker(pytest.mark.slow)
