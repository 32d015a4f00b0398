"""Programs with hard limits, as on shared servers and clusters."""

import ctypes
import resource
import subprocess
import sys

from tests.support.paths import ROOT

_PR_CAPBSET_DROP, _CAP_SYS_RESOURCE = 24, 24


def run_limited(code, limits, **environment):
    """Runs a program that cannot raise its limits, even as root; returns it with its output.

    Args:
        code: the program, in Python.
        limits: hard limits by their names in the module ``resource``.
        environment: further environment variables.
    """

    def apply():
        ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _CAP_SYS_RESOURCE, 0, 0, 0)
        for name, most in limits.items():
            resource.setrlimit(getattr(resource, name), (most, most))

    # The program loses the capability when it starts another one, here `env`.
    variables = [f"{name}={value}" for name, value in environment.items()]
    command = ["env", *variables, sys.executable, "-c", code]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, preexec_fn=apply
    )
