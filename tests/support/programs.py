"""Programs that fork from a process in which the libraries are imported already."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.paths import ROOT

#: Reads programs from its standard input. Forks for each one, and prints the exit status. The names
#: of the imports are those of the program.
LOOP = """
import json, os, sys

for line in iter(sys.stdin.readline, ""):
    if not (pid := os.fork()):
        break
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
else:
    sys.exit()
program = json.loads(line)
os.chdir(program["folder"])
sys.path.insert(0, program["folder"])
for number, file in enumerate([os.devnull, *program["output"]]):
    os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT if number else os.O_RDONLY), number)
exec(compile(program["code"], "program", "exec"), globals())
"""


class ProgramRunner:
    """Starts programs without the imports that they share. A context manager.

    The programs are processes of their own, with their own engine processes.
    """

    def __init__(self, imports, *options):
        self._process = subprocess.Popen(
            [sys.executable, *options, "-c", imports + LOOP],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def run(self, code, folder="."):
        """Runs code in a folder to its end; returns the finished process with its output."""
        with tempfile.TemporaryDirectory() as outputs:
            files = [Path(outputs, name) for name in ("stdout", "stderr")]
            program = {"code": code, "folder": str(folder), "output": [str(f) for f in files]}
            print(json.dumps(program), file=self._process.stdin, flush=True)
            status = int(self._process.stdout.readline())
            return subprocess.CompletedProcess(code, status, *(f.read_text() for f in files))
