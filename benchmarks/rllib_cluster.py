"""Tests self-play with RLlib on a two-node cluster while an env runner and a node are killed.

python -m benchmarks.rllib_cluster                  some minutes, 2 GB of disk for Ray
python -m benchmarks.rllib_cluster --folder /big    use or reuse Ray's environment elsewhere

Both nodes are on this machine, but the second one has its own cache folder without the game data,
which must be sent to it. During the run, the second node's env runner is killed with SIGKILL.
After it has been restarted, the whole node is killed, and later a third node joins. The run must
complete all iterations. The result is ``benchmarks/results/rllib_cluster.json``.
"""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from benchmarks.ecosystem import run_in_environment
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "rllib_cluster.json"
_RUNNER = "ray::RaceEnvRunner"
_CACHE = "STKZOO_CACHE"
#: Number of iterations between two disturbances.
PAUSE = 2


def main() -> int:
    """Runs the trial; returns 0 if the run completes and its env runners restart."""
    parser = CommandParser(prog="python -m benchmarks.rllib_cluster", description=__doc__)
    parser.add_argument(
        "--folder", type=Path, default=ROOT / ".ecosystem", help="folder of Ray's environment"
    )
    parser.add_argument("--iterations", type=int, default=40, help="total (default: %(default)s)")
    parser.add_argument("--pack", default="", help="headless pack to send; empty makes one")
    parser.add_argument("--timeout", type=float, default=1800.0, help="time limit in seconds")
    args = parser.parse_args()
    if args.iterations < 5 * PAUSE:
        parser.error(f"--iterations is {args.iterations}, expected {5 * PAUSE} or more")
    if importlib.util.find_spec("ray") is None:
        return run_in_environment("rllib", args.folder, "benchmarks.rllib_cluster", sys.argv[1:])
    with tempfile.TemporaryDirectory(prefix="stkzoo-rllib-") as folder:
        result = Trial(Path(folder), args.iterations, args.timeout, args.pack).run()
    write_text(RESULTS, json.dumps(result, indent=1) + "\n")
    print(json.dumps({k: v for k, v in result.items() if k != "log"}, indent=1))
    return 0 if result["passed"] else 1


class Trial:
    """A training run on a cluster."""

    def __init__(self, folder: Path, iterations: int, timeout: float, pack: str) -> None:
        self._pack = pack
        self._folder, self._iterations = folder, iterations
        self._run_folder, self._said = folder / "run", folder / "said.txt"
        self._end = time.monotonic() + timeout
        self._begun = time.monotonic()
        self._events: list[dict[str, Any]] = []

    def run(self) -> dict[str, Any]:
        """Runs the trial and returns its result."""
        os.environ["RAY_AUTH_MODE"] = "disabled"  # the cluster is only for this trial
        from ray.cluster_utils import Cluster

        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
        try:
            node = self._join(cluster, "second")
            training = self._start(cluster.address)
            try:
                self._disturb(cluster, node, training)
                code = training.wait(max(self._end - time.monotonic(), 1))
            finally:
                training.kill()
                training.wait()
        finally:
            cluster.shutdown()
        return self._result(code)

    def _join(self, cluster: Any, name: str) -> Any:
        node = cluster.add_node(num_cpus=1, env_vars={_CACHE: str(self._folder / name)})
        self._note(f"the {name} node has joined")
        return node

    def words(self, address: str) -> list[str]:
        """Returns the options of the training command."""
        options = {
            "address": address,
            "output": self._run_folder,
            "iterations": self._iterations,
            "env-runners": 2,
            "track": "lighthouse",
            "learners": 1,
            "frozen": 1,
            "bots": 1,
            "slots": 2,
            "least-races": 2,
            "promote-at": 0.0,
            "max-cycles": 60,
            "train-batch-size": 120,
            "batch-size": 60,
            "n-epochs": 1,
            **({"pack": self._pack} if self._pack else {}),
            "checkpoint-every": 10,
        }
        return [word for name, value in options.items() for word in (f"--{name}", str(value))]

    def _start(self, address: str) -> subprocess.Popen[bytes]:
        with self._said.open("wb") as said:
            return subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "stkzoo.agents.training.rllib.selfplay",
                    *self.words(address),
                ],
                stdout=said,
                stderr=subprocess.STDOUT,
            )

    def _disturb(self, cluster: Any, node: Any, training: subprocess.Popen[bytes]) -> None:
        self._wait(training, lambda: self._done() >= PAUSE)
        victims = self._runners()
        os.kill(victims[0], signal.SIGKILL)
        self._note("the env runner on the second node is killed by SIGKILL")
        self._wait(training, lambda: self._log()[-1]["restarted"] > 0)
        self._note("it is back")
        self._pause(training)
        cluster.remove_node(node, allow_graceful=False)
        self._note("the second node is killed")
        self._pause(training)
        self._join(cluster, "third")

    def _pause(self, training: subprocess.Popen[bytes]) -> None:
        then = self._done()
        self._wait(training, lambda: self._done() >= then + PAUSE)

    def _wait(self, training: subprocess.Popen[bytes], happened: Callable[[], bool]) -> None:
        while not happened():
            if training.poll() is not None or time.monotonic() > self._end:
                raise SystemExit(
                    f"the run ended too soon, or took too long:\n{self._said.read_text()[-4000:]}"
                )
            time.sleep(0.2)

    def _log(self) -> list[dict[str, Any]]:
        file = self._run_folder / "log.jsonl"
        return [json.loads(text) for text in file.read_text().splitlines()] if file.exists() else []

    def _done(self) -> int:
        return len(self._log())

    def _runners(self) -> list[int]:
        """Returns the process ids of the second node's env runners."""
        import psutil

        found = []
        for process in psutil.process_iter(["cmdline"]):
            words = " ".join(process.info["cmdline"] or [])
            if words.startswith(_RUNNER) and process.environ().get(_CACHE, "").endswith("second"):
                found.append(process.pid)
        return found

    def _note(self, what: str) -> None:
        seconds = round(time.monotonic() - self._begun, 1)
        print(f"{seconds:8.1f} s  {what}", flush=True)
        self._events.append({"seconds": seconds, "iterations_done": self._done(), "what": what})

    def _result(self, code: int) -> dict[str, Any]:
        log = self._log()
        sent = [n for n in ("second", "third") if (self._folder / n / "headless").exists()]
        done = [line["iteration"] for line in log]
        restarted = log[-1]["restarted"] if log else 0
        return {
            "passed": code == 0
            and done == list(range(1, self._iterations + 1))
            and restarted > 0
            and "second" in sent,
            "exit_code": code,
            "iterations_wanted": self._iterations,
            "iterations_done": len(done),
            "env_runners_restarted": restarted,
            "snapshots": log[-1]["promotions"] if log else 0,
            "nodes_that_were_sent_the_game": sent,
            "seconds": round(time.monotonic() - self._begun, 1),
            "events": self._events,
            "versions": {
                name: version(name) for name in ("ray", "gymnasium", "torch", "pettingzoo")
            },
            "system": f"Python {platform.python_version()}, {os.cpu_count()} cores",
            "log": log,
        }


if __name__ == "__main__":
    sys.exit(main())
