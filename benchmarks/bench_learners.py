"""Compares learners with the bare engine, in kart-steps per second and core.

    python -m benchmarks.bench_learners
    python -m benchmarks.bench_learners --only engine ppo --rounds 3
    python -m benchmarks.bench_learners --only ppo --karts 1 5 20 --races 2 8 --cores 1 2
    python -m benchmarks.bench_learners --only engine ppo --races 4 --per-core --cores 1 4 16
    python -m benchmarks.bench_learners --only engine rllib torchrl

Contenders take turns. Each turn runs in a separate process that may use all cores. With every
contender but engine, one policy drives all karts:

engine  pystk2 alone: one race per core, with recorded controls of the heuristic agent
ppo     stkzoo.agents.training.ppo.selfplay
sb3     PPO of Stable-Baselines3 on RaceVecEnv in the view racing
rllib   PPO of Ray RLlib with stkzoo.agents.training.rllib.selfplay
torchrl PPO of TorchRL on RaceVectorEnv in the view racing

By default, all contenders run whose libraries are installed. If --only names a contender whose
library is missing, the command installs the library in an environment below --folder.

The start and the first updates are not counted; resets and learning are. The time of all cores is
divided into shares: the game's processes, observations, networks, learning, the rest of the
programs, and waiting, when a core was idle.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import (
    Table,
    cores,
    parser,
    progress_bar,
    quantiles,
    save,
    spread,
)
from benchmarks.bench_driver import (
    WARMUP,
    Contender,
    Spec,
    answer_of,
    record_controls,
)
from benchmarks.bench_shares import (
    SHARES,
    WARM_UP,
    Meter,
    engine_time,
    processor_times,
    shares_of,
)
from benchmarks.ecosystem import ROOT, environment
from stkzoo._os import cpu_count

#: Measured parts of an actor's time.
_ACTOR_PARTS = ("networks", "observing")
CONTENDERS = ("engine", "ppo", "sb3", "rllib", "torchrl")
#: The module that a contender needs, and the key of its environment in ``ecosystem.SETS``.
_LIBRARIES = {"rllib": ("ray", "rllib"), "torchrl": ("torchrl", "main")}


@dataclass(frozen=True)
class Setting:
    """Settings of one measurement.

    Attributes:
        name: one of :data:`CONTENDERS`.
        karts: number of karts in a race.
        races: number of races; the engine has one per core.
        cores: number of cores; 0 for all.
    """

    name: str
    karts: int
    races: int
    cores: int


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "learners", steps=400, karts=(10,), cores=(0,))
    installed = [name for name in CONTENDERS if _is_installed(name)]
    words.add_argument("--only", nargs="+", choices=CONTENDERS, default=installed)
    words.add_argument(
        "--folder", type=Path, default=ROOT / ".ecosystem", help="folder of the environments"
    )
    words.add_argument("--races", type=int, nargs="+", default=[8], help="races (default: 8)")
    words.add_argument("--per-core", action="store_true", help="--races counts races per core")
    words.add_argument("--rounds", type=int, default=5, help="measurements of each (default: 5)")
    words.add_argument("--iterations", type=int, default=12, help="measured updates (default: 12)")
    words.add_argument("--contender", help=argparse.SUPPRESS)
    options = words.parse_args(arguments)
    if options.contender:
        setting = Setting(**json.loads(options.contender))
        if setting.cores:
            os.sched_setaffinity(0, cores(setting.cores))
        print(json.dumps(_LEARNERS[setting.name](setting, options)))
        return 0
    found: dict[Setting, list[dict[str, float]]] = {}
    todo = _settings(options)
    pythons = {name: _python(name, options.folder) for name in options.only}
    with progress_bar(len(todo) * options.rounds) as (bar, task):
        for _ in range(options.rounds):
            for setting in todo:
                bar.update(task, description=f"{setting.name}, {setting.karts} karts")
                found.setdefault(setting, []).append(
                    _measure(setting, options, pythons[setting.name])
                )
                bar.advance(task)
    results = [_result(setting, found) for setting in todo]
    save(options.output, "learners", options, results, tables(results))
    return 0


def _settings(options: argparse.Namespace) -> list[Setting]:
    """Returns the settings that the options select."""
    found = []
    for num_cores, karts in itertools.product(options.cores, options.karts):
        for name in options.only:
            if name == "engine":
                found.append(_engine_setting(karts, num_cores))
                continue
            unit = (num_cores or cpu_count()) if options.per_core else 1
            found += [Setting(name, karts, races * unit, num_cores) for races in options.races]
    return found


def _engine_setting(karts: int, num_cores: int) -> Setting:
    return Setting("engine", karts, num_cores or cpu_count(), num_cores)


def _is_installed(name: str) -> bool:
    return name not in _LIBRARIES or importlib.util.find_spec(_LIBRARIES[name][0]) is not None


def _python(name: str, folder: Path) -> str:
    """Returns the interpreter with a contender's library; makes its environment if necessary."""
    if _is_installed(name):
        return sys.executable
    where = _LIBRARIES[name][1]
    return str(environment(folder, where))


def _measure(setting: Setting, options: argparse.Namespace, python: str) -> dict[str, float]:
    if setting.name == "engine":
        return {"rate": _engine_rate(setting, options)}
    words = ["--steps", str(options.steps), "--iterations", str(options.iterations)]
    words += ["--track", options.track]
    found: dict[str, float] = answer_of("bench_learners", asdict(setting), words, {}, python)
    return found


def _engine_rate(setting: Setting, options: argparse.Namespace) -> float:
    """Returns the kart-steps per second and core of races on all cores at once."""
    karts, count = setting.karts, setting.races
    controls = record_controls(options.track, karts, karts, 1, WARMUP + options.steps)
    pinned = cores(setting.cores)
    with ExitStack() as stack, ThreadPoolExecutor(count) as threads:
        spec = Spec("bare", num_kart=karts, num_agents=karts, cores=pinned)
        races = [stack.enter_context(Contender(spec)) for _ in range(count)]
        for race in races:
            race.ask("load")
            race.ask("make")
            race.ask("reset", track=options.track, seed=1, controls=controls)
            race.ask("steps", count=WARMUP)
        begin = time.perf_counter()
        list(threads.map(lambda race: race.ask("steps", count=options.steps), races))
        return float(karts * options.steps / (time.perf_counter() - begin))


# ---------------------------------------------------------------------- learners


def _ppo(setting: Setting, options: argparse.Namespace) -> dict[str, float]:
    from stkzoo.agents.training.common.actors import ActorPool, SharedArray
    from stkzoo.agents.training.ppo import selfplay

    class Learner(selfplay.PPOLearner):
        def _new_actors(self, arguments: Sequence[Any]) -> ActorPool:
            self._meters = [SharedArray((len(_ACTOR_PARTS),), np.float64) for _ in arguments]
            pairs = zip(arguments, self._meters, strict=True)
            return ActorPool(_measured_actor, [(*own, meter) for own, meter in pairs])

        def parts(self) -> dict[str, float]:
            total = sum(meter.array() for meter in self._meters)
            return dict(zip(_ACTOR_PARTS, total.tolist(), strict=True))

        def pids(self) -> list[int]:
            return self._actors.pids

    arguments = selfplay.SelfPlayArguments(
        tracks=(options.track,), races=(f"{setting.karts}x{setting.races}",), checkpoint_every=10**6
    )
    with tempfile.TemporaryDirectory() as folder:
        learner = Learner(folder, arguments)
        try:
            for _ in range(WARM_UP):
                learner.iterate()
            before, parts_before = _moment(learner.pids()), learner.parts()
            begin, steps, learned = time.perf_counter(), learner.kart_steps, time.process_time()
            for _ in range(options.iterations):
                learner.iterate()
            wall = time.perf_counter() - begin
            learned = time.process_time() - learned
            after, parts = _moment(learner.pids()), learner.parts()
            steps = learner.kart_steps - steps
        finally:
            learner.close()
    engine, programs = (new - old for new, old in zip(after, before, strict=True))
    own = {name: parts[name] - parts_before[name] for name in parts} | {"learning": learned}
    return {"rate": steps / wall / cpu_count(), **shares_of(wall, engine, programs, own)}


def _moment(actors: Sequence[int]) -> tuple[float, float]:
    """Returns the CPU times of the game's processes, and of this program with its actors [s]."""
    times = processor_times()
    programs = time.process_time() + sum(times[pid][1] for pid in actors)
    return engine_time(actors), programs


def _measured_actor(arguments: Any, memory: Any, seconds: Any) -> Any:
    from stkzoo.agents.training.ppo import rollouts

    meter, shared = Meter(), seconds.array()

    class Actor(rollouts.RaceActor):
        def _own_outcome(self, outcome: Any) -> Any:  # called once per step
            shared[:] = [meter.seconds.get(name, 0.0) for name in _ACTOR_PARTS]
            return outcome

    actor = Actor(arguments, memory)
    rollouts.predict_values = meter.timed("networks", rollouts.predict_values)
    for owner, method, name in (
        (actor, "_choose", "networks"),
        (actor._fleet, "_look", "observing"),
    ):
        setattr(owner, method, meter.timed(name, getattr(owner, method)))
    return actor


def _sb3(setting: Setting, options: argparse.Namespace) -> dict[str, float]:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback

    from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv

    torch.set_num_threads(1)
    envs = RaceVecEnv(
        setting.races,
        num_kart=setting.karts,
        track=options.track,
        view="racing",
        start="random",
        max_cycles=250,
        num_starts=32,
    )
    model = PPO(
        "MlpPolicy",
        envs,
        rollout_buffer_class=ActiveRolloutBuffer,
        n_steps=128,
        batch_size=512,
        n_epochs=4,
        policy_kwargs={"net_arch": [128, 128]},
        device="cpu",
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

    rollouts = WARM_UP + options.iterations
    model.learn(rollouts * 128 * envs.num_envs + 1, callback=Marks())
    envs.close()
    first, last = marks[WARM_UP], marks[rollouts]
    wall, programs, engine, steps = (last[n] - first[n] for n in range(4))
    parts = {name: last[4][name] - first[4][name] for name in first[4]}
    return {"rate": steps / wall / cpu_count(), **shares_of(wall, engine, programs, parts)}


def _other(setting: Setting, options: argparse.Namespace) -> dict[str, float]:
    from benchmarks import bench_libraries

    found: dict[str, float] = getattr(bench_libraries, setting.name)(setting, options)
    return found


_LEARNERS = {"ppo": _ppo, "sb3": _sb3, "rllib": _other, "torchrl": _other}

# ---------------------------------------------------------------------- results


def _result(setting: Setting, found: Mapping[Setting, Sequence[Mapping[str, float]]]) -> Any:
    rounds = found[setting]
    bare = found.get(_engine_setting(setting.karts, setting.cores), ())
    ratios = [own["rate"] / its["rate"] for own, its in zip(rounds, bare, strict=False)]
    return {
        **asdict(setting),
        "kart_steps_per_second_per_core": quantiles(own["rate"] for own in rounds),
        "to_engine": quantiles(ratios) if ratios else None,
        "shares": {
            share: statistics.median(own[share] for own in rounds)
            for share in SHARES
            if share in rounds[0]
        },
    }


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns the results as a table."""
    rows = []
    for result in results:
        rate = result["kart_steps_per_second_per_core"]
        shares = [result["shares"].get(share) for share in SHARES]
        rows.append(
            (
                result["name"],
                *(str(result[name]) for name in ("karts", "races")),
                str(result["cores"] or "all"),
                spread(rate),
                spread(result["to_engine"], 2),
                f"{1e6 / rate['median'] / 60:.1f}",
                *("-" if share is None else f"{share:.0%}" for share in shares),
            )
        )
    columns = ("", "karts", "races", "cores", "kart-steps/s/core", "to engine", "core minutes")
    note = (
        "to engine: the rate relative to the engine's in the same round; core minutes: per million "
        "kart-steps; other columns: shares of the time of all cores"
    )
    return [Table("learners: median (10..90%)", (*columns, *SHARES), rows, note)]


if __name__ == "__main__":
    sys.exit(main())
