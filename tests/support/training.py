"""Runs training commands in this program, and kills them in a fork of it."""

import os
import signal
import warnings

from tests.support.processes import wait_until


def words_of(folder, settings, **more):
    """Returns the command line for a folder and settings by name."""
    words = [f"--output={folder}"]
    for name, value in {**settings, **more}.items():
        option = name.removesuffix("s") if name.endswith("tracks") else name
        words.append("--" + option.replace("_", "-"))
        if value is not True:
            words += map(str, value) if isinstance(value, tuple) else [str(value)]
    return words


def run_and_kill(main, words, log, lines):
    """Runs a command in a forked process and kills it when its log has ``lines`` lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the test run has threads
        process = os.fork()
    if process == 0:
        try:
            main(words)
        finally:
            os._exit(1)  # a command that ends by itself exits with 1
    try:
        assert wait_until(lambda: log.exists() and log.read_text().count("\n") >= lines, 120)
    finally:
        os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
    assert os.WIFSIGNALED(status)
