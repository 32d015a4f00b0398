"""Runs training commands in this program, kills them in a fork of it, and reads what they wrote."""

import json
import os
import signal
import warnings

from stkzoo.agents.pretrained.weights import load_weights
from tests.support.processes import wait_until

_TIMES = ("wait_s", "learn_s", "kart_steps_per_s")


def words_of(folder, settings, **more):
    """Returns the command line for a folder and settings by name."""
    words = [f"--output={folder}"]
    for name, value in {**settings, **more}.items():
        option = name.removesuffix("s") if name.endswith("tracks") else name
        words.append("--" + option.replace("_", "-"))
        if value is not True:
            words += map(str, value) if isinstance(value, tuple) else [str(value)]
    return words


def log_of(folder):
    """Returns the lines of a run's log without the figures that depend on the machine's speed."""
    lines = map(json.loads, (folder / "log.jsonl").read_text().splitlines())
    return [{name: line[name] for name in line if name not in _TIMES} for line in lines]


def last_policy(folder):
    """Returns the weights of a run's newest policy."""
    return load_weights(max(folder.glob("policy-*.safetensors")))


def run_and_kill(main, words, log, lines, seconds=120):
    """Runs a command in a forked process and kills it when its log has ``lines`` lines."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the test run has threads
        process = os.fork()
    if process == 0:
        try:
            main(words)
        finally:
            os._exit(1)  # a command that ends by itself exits with 1

    def is_due():
        has_ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        return has_ended or (log.exists() and log.read_text().count("\n") >= lines)

    try:
        assert wait_until(is_due, seconds)
    finally:
        os.kill(process, signal.SIGKILL)
        _, status = os.waitpid(process, 0)
    assert os.WIFSIGNALED(status)
