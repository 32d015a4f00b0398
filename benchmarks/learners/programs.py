"""The measured learners. Each function runs in a new interpreter.

They take the number of karts in a race, of races and of cores, the track and the number of measured
updates, and return the kart-steps per second and core, and the shares of the time of all cores.
"""

from __future__ import annotations

import os
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import cores
from benchmarks.learners.shares import Meter, engine_time, processor_times, shares_of
from stkzoo._os import cpu_count

#: Updates before the measured ones, in which nearly all starts are made once.
_WARM_UP = 8
#: Different starts that the races copy.
_NUM_STARTS = 8
#: Steps of each kart per update of sb3, pytorch and rllib, and of an episode.
_STEPS, _MAX_CYCLES = 128, 250
#: Options of the races of sb3 and pytorch.
_RACES = {"max_cycles": _MAX_CYCLES, "num_starts": _NUM_STARTS}
#: Measured parts of an actor's time.
_ACTOR_PARTS = ("networks", "observing")


def _use_cores(number: int) -> None:
    if number:
        os.sched_setaffinity(0, cores(number))


# ---------------------------------------------------------------------- PPO of stkzoo


def ppo(karts: int, races: int, number: int, track: str, iterations: int) -> dict[str, float]:
    """Measures ``stkzoo.agents.training.ppo.selfplay``."""
    _use_cores(number)
    from stkzoo.agents.training.ppo.run import PPORun
    from stkzoo.agents.training.ppo.selfplay import SelfPlayArguments, selfplay_setup

    arguments = SelfPlayArguments(
        tracks=(track,),
        races=(f"{karts}x{races}",),
        num_starts=_NUM_STARTS,
        checkpoint_every=10**6,
    )
    with tempfile.TemporaryDirectory() as folder:
        run = _measured_run(PPORun)(folder, arguments, selfplay_setup(arguments))
        try:
            for _ in range(_WARM_UP):
                run.iterate()
            before, parts_before = _moment(run.pids()), run.parts()
            begin, steps, learned = time.perf_counter(), run.kart_steps, time.process_time()
            for _ in range(iterations):
                run.iterate()
            wall = time.perf_counter() - begin
            learned = time.process_time() - learned
            after, parts = _moment(run.pids()), run.parts()
            steps = run.kart_steps - steps
        finally:
            run.close()
    engine, programs = (new - old for new, old in zip(after, before, strict=True))
    spent = {name: parts[name] - parts_before[name] for name in parts} | {"learning": learned}
    return {"rate": steps / wall / cpu_count(), **shares_of(wall, engine, programs, spent)}


def _measured_run(run_class: Any) -> Any:
    """Returns a class of runs whose actors measure the parts of their time."""
    from stkzoo.agents.training.common.actors import ActorPool, SharedArray

    class Run(run_class):
        def _new_actors(self, arguments: Sequence[Any]) -> ActorPool:
            self._meters = [SharedArray((len(_ACTOR_PARTS),), np.float64) for _ in arguments]
            pairs = zip(arguments, self._meters, strict=True)
            return ActorPool(_measured_actor, [(*own, meter) for own, meter in pairs])

        def parts(self) -> dict[str, float]:
            total = sum(meter.array() for meter in self._meters)
            return dict(zip(_ACTOR_PARTS, total.tolist(), strict=True))

        def pids(self) -> list[int]:
            return self._actors.pids

    return Run


def _measured_actor(arguments: Any, memory: Any, seconds: Any) -> Any:
    from stkzoo.agents.training.ppo import rollouts

    meter, shared = Meter(), seconds.array()

    class Actor(rollouts.RaceActor):
        def drive(self, *given: Any) -> Any:
            result = super().drive(*given)
            shared[:] = [meter.seconds.get(name, 0.0) for name in _ACTOR_PARTS]
            return result

    for name in ("policy_logits", "sample", "values_of"):
        setattr(rollouts, name, meter.timed("networks", getattr(rollouts, name)))
    actor = Actor(arguments, memory)
    for part in actor._parts:
        for name in ("observe", "drive"):
            view = part.envs.view
            setattr(view, name, meter.timed("observing", getattr(view, name)))
    return actor


def _moment(actors: Sequence[int]) -> tuple[float, float]:
    """Returns the CPU times of the game's processes, and of this program with its actors [s]."""
    times = processor_times()
    programs = time.process_time() + sum(times[pid][1] for pid in actors)
    return engine_time(actors), programs


# ---------------------------------------------------------------------- other libraries


def sb3(karts: int, races: int, number: int, track: str, iterations: int) -> dict[str, float]:
    """Measures PPO of Stable-Baselines3 on ``RaceVecEnv``."""
    _use_cores(number)
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from torch.distributions import Distribution

    from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv

    torch.set_num_threads(1)
    Distribution.set_default_validate_args(False)
    race = {"num_kart": karts, "track": track, "view": "racing", "start": "random"}
    envs = RaceVecEnv(races, **_RACES, **race)
    settings = {"n_steps": _STEPS, "batch_size": 512, "n_epochs": 4, "device": "cpu"}
    model = PPO(
        "MlpPolicy",
        envs,
        rollout_buffer_class=ActiveRolloutBuffer,
        policy_kwargs={"net_arch": [128, 128]},
        **settings,
    )
    meter, marks = Meter(), []
    for owner, method, name in (
        (model, "train", "learning"),
        (model.policy, "forward", "networks"),
        (envs, "step_async", "observing"),
        (envs, "step_wait", "observing"),
    ):
        setattr(owner, method, meter.timed(name, getattr(owner, method)))

    class Marks(BaseCallback):
        """Records the times and counts at the start of each rollout."""

        def _on_rollout_start(self) -> None:
            now = time.perf_counter(), time.process_time(), engine_time(())
            marks.append((*now, self.num_timesteps, dict(meter.seconds)))

        def _on_step(self) -> bool:
            return True

    rollouts = _WARM_UP + iterations
    model.learn(rollouts * _STEPS * envs.num_envs + 1, callback=Marks())
    envs.close()
    return _rate_between(marks[_WARM_UP], marks[rollouts])


def pytorch(karts: int, races: int, number: int, track: str, iterations: int) -> dict[str, float]:
    """Measures the loop of ``docs/how-to/pytorch.md``; its networks and learning count as rest."""
    _use_cores(number)
    import stkzoo

    meter, marks = Meter(), []

    class Races(stkzoo.RaceVectorEnv):
        """Records the times and counts at the start of each rollout."""

        def __init__(self, _: int, **options: Any) -> None:
            race = {"num_kart": karts, "track": track, **_RACES}
            super().__init__(races, **options | race)
            self.timed_step = meter.timed("observing", super().step)
            self.count = self.kart_steps = 0

        def step(self, actions: Any) -> Any:
            if self.count % _STEPS == 0:
                self.mark()
            self.count += 1
            result = self.timed_step(actions)
            self.kart_steps += int(result[4]["active"].sum())
            return result

        def mark(self) -> None:
            now = time.perf_counter(), time.process_time(), engine_time(())
            marks.append((*now, self.kart_steps, dict(meter.seconds)))

        def close(self, **options: Any) -> None:
            self.mark()
            super().close(**options)

    stkzoo.RaceVectorEnv = Races  # type: ignore[misc] # for the program of the page
    page = Path(__file__).parents[2] / "docs" / "how-to" / "pytorch.md"
    block = re.search(r"```python\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    size = f"STEPS, UPDATES = {_STEPS}, {_WARM_UP + iterations}"
    code, changed = re.subn(r"^STEPS, UPDATES = .*", size, block[1] if block else "", flags=re.M)
    if not changed:
        raise LookupError(f"{page.name} has no program with STEPS, UPDATES = ...")
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # the program writes a driver
        exec(compile(code, page.name, "exec"), {"__name__": "__main__"})  # noqa: S102
    return _rate_between(marks[_WARM_UP], marks[-1])


def _rate_between(first: Sequence[Any], last: Sequence[Any]) -> dict[str, float]:
    """Returns the rate and the shares between two moments.

    Args:
        first: wall, CPU and engine time [s], number of kart-steps, and time of each part.
        last: the same later.
    """
    wall, programs, engine, steps = (last[n] - first[n] for n in range(4))
    parts = {name: last[4][name] - first[4][name] for name in first[4]}
    return {"rate": steps / wall / cpu_count(), **shares_of(wall, engine, programs, parts)}


def rllib(karts: int, races: int, number: int, track: str, iterations: int) -> dict[str, float]:
    """Measures the algorithm of rllib.selfplay, with one env runner per core and no past selves."""
    _use_cores(number)
    import ray

    from stkzoo.agents.training.rllib.races import MAIN, RLlibArguments
    from stkzoo.agents.training.rllib.selfplay import build_config

    runners = min(cpu_count(), races)
    steps = _STEPS * karts * races
    arguments = RLlibArguments(
        tracks=(track,),
        learners=karts,
        frozen=0,
        bots=0,
        env_runners=runners,
        envs_per_runner=races // runners,
        max_cycles=_MAX_CYCLES,
        hidden=(128, 128),
        train_batch_size=steps,
        batch_size=min(512, steps),
        n_epochs=4,
    )
    ray.init(address="local", num_cpus=runners, include_dashboard=False, log_to_driver=False)
    algorithm = build_config(arguments).build_algo()

    def kart_steps(count: int) -> float:
        for _ in range(count):
            result = algorithm.train()
        return float(result["env_runners"]["num_module_steps_sampled_lifetime"][MAIN])

    try:
        before, begin = kart_steps(_WARM_UP), time.perf_counter()
        made = kart_steps(iterations) - before
        return {"rate": made / (time.perf_counter() - begin) / cpu_count()}
    finally:
        algorithm.stop()
        ray.shutdown()
