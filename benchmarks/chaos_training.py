"""Trains with PPO in self-play while a game process is killed every 20 seconds.

Stable-Baselines3's PPO drives all karts of two races (`stkzoo.sb3.RaceVecEnv`) for a number of
agent-steps. Meanwhile a thread kills or stops one of the game processes or their fork server. The
run must finish with the right number of steps, with finite values only, and without leftover
processes.

    python -m benchmarks.chaos_training                     # 200,000 steps, ten minutes
    python -m benchmarks.chaos_training --steps 20000 --every 5
"""

from __future__ import annotations

import json
import math
import os
import random
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import RESULTS, host_facts, progress_bar
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from tests.chaos.family import family
from tests.support.processes import wait_until

OUTPUT = RESULTS / "robustness" / "training.json"
_RACES, _KARTS = 2, 4
_ROLLOUT = 256
#: Signals to send in turn, and the kind of process that receives each.
_BLOWS = (
    ("SIGKILL", "race"),
    ("SIGSEGV", "race"),
    ("SIGSTOP", "race"),
    ("SIGKILL", "fork server"),
    ("SIGKILL", "race"),
)
_ENGINE_TIMEOUT = 5.0  # [s]


def main(argv: Sequence[str] | None = None) -> int:
    """Trains while killing processes, and writes the results."""
    words = CommandParser(prog="python -m benchmarks.chaos_training", description=__doc__)
    words.add_argument("--steps", type=int, default=200_000, metavar="N", help="agent-steps")
    words.add_argument("--every", type=float, default=20.0, metavar="SECONDS", help="kill interval")
    words.add_argument("--output", type=Path, default=OUTPUT, help="JSON file to write")
    arguments = words.parse_args(argv)
    result = train(arguments.steps, arguments.every)
    print(json.dumps(result, indent=2))
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    write_text(arguments.output, json.dumps(result, indent=2) + "\n")
    return 0 if result["survived"] else 1


def train(steps: int, every: float) -> dict[str, Any]:
    """Trains for ``steps`` agent-steps, with a kill every ``every`` seconds."""
    import torch
    from stable_baselines3 import PPO

    from stkzoo.sb3 import ActiveDictRolloutBuffer, RaceVecEnv

    torch.set_num_threads(1)
    envs = RaceVecEnv(
        _RACES, num_kart=_KARTS, track="train", max_cycles=300, engine_timeout=_ENGINE_TIMEOUT
    )
    model = PPO(
        "MultiInputPolicy",
        envs,
        rollout_buffer_class=ActiveDictRolloutBuffer,
        n_steps=_ROLLOUT,
        batch_size=512,
        n_epochs=3,
        seed=1,
        device="cpu",
    )
    begin = time.monotonic()
    with progress_bar(steps) as (progress, task):
        watch = _watch(lambda: progress.update(task, completed=model.num_timesteps))
        with _Killer(every) as killer:
            model.learn(steps, callback=watch)
    seconds = time.monotonic() - begin
    crashes = envs.num_crashes
    envs.close()
    rollout = _ROLLOUT * envs.num_envs
    expected = math.ceil(steps / rollout) * rollout  # whole rollouts, as PPO counts
    gone = wait_until(lambda: not [m for m in family(os.getpid()) if m.kind != "fork server"], 10)
    parameters = torch.cat([weights.detach().flatten() for weights in model.policy.parameters()])
    problems = [
        *watch.problems,
        *([] if model.num_timesteps == expected else [f"{model.num_timesteps} steps"]),
        *([] if torch.isfinite(parameters).all() else ["weights that are not finite"]),
        *([] if gone else ["processes are left"]),
    ]
    return {
        "survived": not problems,
        "problems": problems,
        "steps": model.num_timesteps,
        "expected_steps": expected,
        "updates": watch.rollouts,
        "active_steps": watch.active,
        "kills": len(killer.blows),
        "kills_by_kind": dict(Counter(killer.blows)),
        "races_replaced": crashes,
        "seconds": round(seconds, 1),
        "every_seconds": every,
        "host": host_facts(),
    }


def _watch(tell: Any) -> Any:
    """Returns a callback that checks each rollout and each logged figure for finite values."""
    from stable_baselines3.common.callbacks import BaseCallback

    class Watch(BaseCallback):
        def __init__(self) -> None:
            super().__init__()
            self.rollouts = self.active = 0
            self.problems: list[str] = []

        def _on_step(self) -> bool:
            self.active += sum(bool(info.get("active", True)) for info in self.locals["infos"])
            return True

        def _on_rollout_end(self) -> None:
            self.rollouts += 1
            tell()
            buffer = self.model.rollout_buffer
            parts = {**buffer.observations, "rewards": buffer.rewards}
            parts |= {"values": buffer.values, "advantages": buffer.advantages}
            self._check({name: bool(np.isfinite(part).all()) for name, part in parts.items()})

        def _on_rollout_start(self) -> None:
            told = self.logger.name_to_value
            self._check({name: bool(np.isfinite(value)) for name, value in told.items()})

        def _check(self, finite: dict[str, bool]) -> None:
            bad = [name for name, is_finite in finite.items() if not is_finite]
            if bad:
                self.problems.append(f"rollout {self.rollouts}: not finite: {', '.join(bad)}")

    return Watch()


class _Killer:
    """A context manager that sends a signal to a random process every ``every`` seconds.

    Attributes:
        blows: descriptions of the signals sent.
    """

    def __init__(self, every: float) -> None:
        self.blows: list[str] = []
        self._every, self._end = every, threading.Event()
        self._chance = random.Random(1)
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> _Killer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._end.wait(self._every):
            name, kind = _BLOWS[len(self.blows) % len(_BLOWS)]
            targets = [member.pid for member in family(os.getpid()) if member.kind == kind]
            if targets:
                with suppress(ProcessLookupError):
                    os.kill(self._chance.choice(targets), signal.Signals[name])
                    self.blows.append(f"{name} to a {kind}")


if __name__ == "__main__":
    sys.exit(main())
