"""PPO of Ray RLlib and of TorchRL, for bench_learners."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from benchmarks.bench_shares import WARM_UP, Meter, engine_time, shares_of
from stkzoo._os import cpu_count

if TYPE_CHECKING:
    from benchmarks.bench_learners import Setting

#: Steps of each kart per update, as for sb3.
_STEPS = 128
_MAX_CYCLES = 250


def rllib(setting: Setting, options: argparse.Namespace) -> dict[str, float]:
    """Measures the algorithm of rllib.selfplay, with one env runner per core and no past selves."""
    import ray

    runners = min(cpu_count(), setting.races)
    ray.init(address="local", num_cpus=runners, include_dashboard=False, log_to_driver=False)
    try:
        rate = rllib_rate(
            runners, setting.races // runners, setting.karts, options.track, options.iterations
        )
    finally:
        ray.shutdown()
    return {"rate": rate / cpu_count()}


def rllib_rate(runners: int, races: int, karts: int, track: str, iterations: int) -> float:
    """Returns the kart-steps per second of rllib.selfplay, learning included, without past selves.

    Args:
        runners: number of env runners in the running Ray cluster.
        races: number of races of each env runner.
        karts: number of karts of a race.
        track: name of the track.
        iterations: number of updates to measure.
    """
    from stkzoo.agents.training.rllib.races import MAIN, RLlibArguments
    from stkzoo.agents.training.rllib.selfplay import build_config

    steps = _STEPS * karts * races * runners
    arguments = RLlibArguments(
        tracks=(track,),
        learners=karts,
        frozen=0,
        bots=0,
        env_runners=runners,
        envs_per_runner=races,
        max_cycles=_MAX_CYCLES,
        hidden=(128, 128),
        train_batch_size=steps,
        batch_size=min(512, steps),
        n_epochs=4,
    )
    algorithm = build_config(arguments).build_algo()

    def kart_steps(iterations: int) -> float:
        for _ in range(iterations):
            result = algorithm.train()
        return float(result["env_runners"]["num_module_steps_sampled_lifetime"][MAIN])

    try:
        before, begin = kart_steps(WARM_UP), time.perf_counter()
        made = kart_steps(iterations) - before
        return made / (time.perf_counter() - begin)
    finally:
        algorithm.stop()


def torchrl(setting: Setting, options: argparse.Namespace) -> dict[str, float]:
    """Measures TorchRL's collector, GAE and clipped loss, with the network and epochs of sb3."""
    import torch
    from tensordict.nn import InteractionType, TensorDictModule
    from torch import nn
    from torchrl.collectors import Collector
    from torchrl.modules import ProbabilisticActor, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    from stkzoo.wrappers.racing import CHOICES, SIZE

    torch.set_num_threads(1)
    envs = _torchrl_races(setting, options.track)
    network, critic = (
        nn.Sequential(nn.Linear(SIZE, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), last)
        for last in (nn.Linear(128, sum(CHOICES)), nn.Linear(128, 1))
    )
    actor = ProbabilisticActor(
        TensorDictModule(network, ["observation"], ["logits"]),
        in_keys=["logits"],
        distribution_class=_distribution(CHOICES),
        return_log_prob=True,
        default_interaction_type=InteractionType.RANDOM,
    )
    value = ValueOperator(critic, ["observation"])
    loss = ClipPPOLoss(actor, value, entropy_coeff=0.0, critic_coeff=0.5)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=value)
    optimizer = torch.optim.Adam(loss.parameters(), 3e-4)
    frames = _STEPS * setting.races * setting.karts
    iterations = WARM_UP + options.iterations
    collector = Collector(
        envs,
        actor,
        frames_per_batch=frames,
        total_frames=frames * (iterations + 1),
        auto_register_policy_transforms=True,
    )

    def learn(batch: Any) -> int:
        with torch.no_grad():
            advantage(batch)
        active = batch.reshape(-1)
        active = active[active["next", "active"]]
        for _ in range(4):
            for rows in torch.randperm(len(active)).split(512):
                found = loss(active[rows])
                optimizer.zero_grad()
                sum(found[name] for name in ("loss_objective", "loss_critic")).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        return len(active)

    meter = Meter()
    learn = meter.timed("learning", learn)
    network.forward = meter.timed("networks", network.forward)
    envs._step = meter.timed("observing", envs._step)
    marks, kart_steps = [], 0
    for batch in collector:
        now = time.perf_counter(), time.process_time(), engine_time(())
        marks.append((*now, kart_steps, dict(meter.seconds)))
        if len(marks) > iterations:
            break
        kart_steps += learn(batch)
    collector.shutdown()
    first, last = marks[WARM_UP], marks[iterations]
    wall, programs, engine, steps = (last[n] - first[n] for n in range(4))
    parts = {name: last[4][name] - first[4][name] for name in first[4]}
    return {"rate": steps / wall / cpu_count(), **shares_of(wall, engine, programs, parts)}


def _distribution(choices: tuple[int, ...]) -> Callable[..., Any]:
    """Returns a distribution class for several choices whose logits are concatenated."""
    import torch
    from torch.distributions import Categorical, Distribution

    class Choices(Distribution):
        """Independent choices."""

        def __init__(self, logits: torch.Tensor) -> None:
            parts = logits.split(list(choices), -1)
            self._parts = [Categorical(logits=part, validate_args=False) for part in parts]
            shape = logits.shape[:-1], torch.Size([len(choices)])
            super().__init__(*shape, validate_args=False)

        def sample(self, shape: Any = ()) -> torch.Tensor:
            return torch.stack([part.sample(shape) for part in self._parts], -1)

        def log_prob(self, value: torch.Tensor) -> torch.Tensor:
            pairs = zip(self._parts, value.unbind(-1), strict=True)
            return torch.stack([part.log_prob(own) for part, own in pairs]).sum(0)

        def entropy(self) -> torch.Tensor:
            return torch.stack([part.entropy() for part in self._parts]).sum(0)

    return Choices


def _torchrl_races(setting: Setting, track: str) -> Any:
    """Returns a ``RaceVectorEnv`` as a batched TorchRL environment; its batch axis is the slots."""
    import torch
    from tensordict import TensorDict
    from torchrl.data import Categorical, Composite, MultiCategorical, Unbounded
    from torchrl.envs import EnvBase

    from stkzoo import RaceVectorEnv
    from stkzoo.wrappers.racing import CHOICES, SIZE

    class Races(EnvBase):
        """Races that restart themselves; ``_first`` holds the observations for the next reset."""

        def __init__(self) -> None:
            self._races = RaceVectorEnv(
                setting.races,
                num_kart=setting.karts,
                track=track,
                view="racing",
                start="random",
                max_cycles=_MAX_CYCLES,
                num_starts=32,
            )
            count = self._races.num_envs
            super().__init__(batch_size=[count])
            flag = Categorical(2, shape=(count, 1), dtype=torch.bool)
            self.observation_spec = Composite(
                observation=Unbounded((count, SIZE)),
                active=Categorical(2, shape=(count,), dtype=torch.bool),
                shape=[count],
            )
            self.action_spec = MultiCategorical(CHOICES, shape=(count, len(CHOICES)))
            self.reward_spec = Unbounded((count, 1))
            self.done_spec = Composite(
                done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=[count]
            )
            self._first: torch.Tensor | None = None

        def _reset(self, _: Any = None, **__: Any) -> Any:
            if self._first is None:
                steps = self._races.reset_slots(1, [None] * setting.races)
                self._first = torch.from_numpy(steps.observations)
            return self._states(self._first, torch.ones(self.batch_size, dtype=torch.bool))

        def _step(self, tensordict: Any) -> Any:
            self._races.step_async(tensordict["action"].numpy())
            steps = self._races.wait_slots()
            self._first = torch.from_numpy(steps.observations)
            seen = self._first.clone()
            for slot, (observation, _) in steps.finals.items():
                seen[slot] = torch.from_numpy(observation)
            found = self._states(seen, torch.from_numpy(steps.active))
            ends = (
                torch.from_numpy(flags)[:, None]
                for flags in (steps.terminations, steps.truncations)
            )
            found["terminated"], found["truncated"] = ends
            found["done"] = found["terminated"] | found["truncated"]
            found["reward"] = torch.from_numpy(steps.rewards).float()[:, None]
            return found

        def _states(self, observations: Any, active: Any) -> Any:
            values = {"observation": observations, "active": active}
            return TensorDict(values, batch_size=self.batch_size)

        def _set_seed(self, seed: int | None) -> None:
            pass

        def close(self, **named: Any) -> None:
            self._races.close()
            super().close(**named)

    return Races()
