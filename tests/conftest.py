"""Settings for the whole test run."""

import os
import signal
from collections import Counter

import pytest

# The test processes share the cores, and small networks are faster on one.
os.environ.setdefault("OMP_NUM_THREADS", "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # inherited, for example after `make test &`
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Returns one worker for each core that this program may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count()


def pytest_terminal_summary(terminalreporter):
    """With ``--durations``, prints how long the tests of each folder took."""
    seconds = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            place = report.nodeid.partition("::")[0].split("/")[:2]
            seconds["/".join(place)] += getattr(report, "duration", 0)
    if terminalreporter.config.getoption("durations"):
        terminalreporter.write_sep("=", "seconds by folder")
        for folder, total in seconds.most_common():
            terminalreporter.write_line(f"{total:6.0f} {folder}")
