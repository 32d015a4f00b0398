"""The reference algorithms of the suite: settings of PPO (:mod:`stkzoo.agents.training.ppo`).

stkzoo suite train versus ippo

- ``ippo``, independent PPO (de Witt et al., 2020): all learners share one policy, which learns from
  each kart's own reward. Policy and value network see the view of one kart; other learners are part
  of its environment.
- ``mappo``, multi-agent PPO (Yu et al., 2022): the value network also sees the own state of all
  other learners, mates first, then by rank. The trained agent does not need it.
- ``pfsp``, prioritized fictitious self-play: in half of the races, one of 40 past policies drives
  one of the teams or half of the karts (:mod:`stkzoo.agents.training.ppo.opponents`). Its
  kart-steps count too.
- ``recurrent`` is ``ippo`` with a memory of its own, a gated recurrent unit (Cho et al., 2014).
- ``blind`` is ``ippo`` whose karts do not see which karts are mates, for comparison in tasks with
  teams.

All act through the action filter (:mod:`stkzoo.agents.pretrained.action_filter`): drifts last, and
stuck karts free themselves. The policy observes the filter's memory.

The folder of a run contains `checkpoint.pt`, `log.jsonl` (one line per iteration), TensorBoard
files, `arguments.json`, the saved policies, and at the end `agent`, the trained agent.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from stkzoo._checks import check_whole
from stkzoo._schema import Share
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.errors import ConfigError
from stkzoo.suite import ALGORITHMS, Task, can_learn, find_task
from stkzoo.wrappers.racing import CONTEST_SIZE, SIZE

from ..common.arguments import BatchSize, Coefficient, Natural, RolloutArguments
from ..export import export_policy
from ..ppo.network import RacingNetwork, RecurrentNetwork
from ..ppo.opponents import NOBODY, PRIORITIZED, Matchmaker
from ..ppo.rollouts import ActorRaces
from ..ppo.run import PPORun, PPOSetup

#: Number of past policies that a run keeps.
_POOL_SIZE = 40
_LEARNERS = 32
#: Size of the memory of ``recurrent``.
_MEMORY_SIZE = 64
#: Opponents of each algorithm, and whether its value network sees the other learners.
_ALGORITHMS = {
    "ippo": (NOBODY, False),
    "mappo": (NOBODY, True),
    "pfsp": (PRIORITIZED, False),
    "recurrent": (NOBODY, False),
    "blind": (NOBODY, False),
}
#: Inputs of the policy that mark mates among the four nearest karts.
_MATE_FLAGS = tuple(range(SIZE + 12, CONTEST_SIZE, 9))
#: Figures of the log to show.
_SHOWN = ("return", "finished", "position", "entropy", "kl", "explained", "beaten")


@dataclass(frozen=True, slots=True)
class TaskArguments(RolloutArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        algorithm: name of the algorithm.
        task: name of the task.
        num_races: number of parallel races; 0 for as many as give 32 learners.
        num_starts: number of different starts in each process between two checkpoints.
        hold: minimum steps of a drift.
        random_starts: share of the races that start anywhere on the track.
    """

    learning_rate: float = 5e-4
    batch_size: BatchSize = 512
    n_epochs: int = 4
    gamma: Share = 0.995
    gae_lambda: Share = 0.9
    ent_coef: Coefficient = 0.001
    target_kl: float = 0.03
    warm_up: Natural = 0
    checkpoint_every: int = 40
    algorithm: str = "ippo"
    task: str = "solo-general"
    num_races: Natural = 0
    num_starts: int = 20
    hold: Natural = 11
    random_starts: Share = 0.5


def task_setup(arguments: TaskArguments, **options: Any) -> PPOSetup:
    """Returns what a run in a task learns.

    Args:
        arguments: arguments of the run.
        **options: other arguments of the races' environments.

    Raises:
        ConfigError: the algorithm cannot learn the task.
    """
    task, name = find_task(arguments.task), arguments.algorithm
    opponents, sees_others = _ALGORITHMS.get(name, (NOBODY, False))
    _check_task(task, name)
    races = arguments.num_races or max(_LEARNERS // task.learners, 1)
    places, is_blind = task.places(), name == "blind"
    if is_blind:
        places = [[replace(spec, team=None) for spec in agents] for agents in places]
    shares = {None: 1 - arguments.random_starts, "random": arguments.random_starts}
    groups = [
        ActorRaces(
            max(round(races * share / len(places)), 1),
            {
                "num_starts": arguments.num_starts,
                **task.options(),
                "agents": agents,
                "start": start,
                **options,
            },
            has_rivals=opponents != NOBODY,
            teams=task.teams,
        )
        for start, share in shares.items()
        for agents in places
        if share
    ]
    num_mates = task.learners - 1 if sees_others else 0
    inputs = CONTEST_SIZE + MEMORY_SIZE
    first = arguments.hidden, arguments.seed, inputs
    unseen = _MATE_FLAGS if is_blind else ()
    network: Callable[[], RacingNetwork] = partial(
        RacingNetwork, *first, num_mates, arguments.hold, unseen
    )
    if name == "recurrent":
        network = partial(RecurrentNetwork, *first, arguments.hold, _MEMORY_SIZE)
    return PPOSetup(
        groups=tuple(groups),
        make_network=network,
        hold=arguments.hold,
        matchmaker=Matchmaker(opponents, _POOL_SIZE),
    )


def _check_task(task: Task, algorithm: str) -> None:
    if algorithm in _ALGORITHMS and not can_learn(algorithm, task):
        raise ConfigError(
            f"{algorithm} needs {ALGORITHMS[algorithm]}, which "
            f"{task.name} does not have; use ippo, which is the same there"
        )


def run(
    algorithm: str, folder: Path, task: str, kart_steps: int, seed: int, **changes: Any
) -> Path:
    """Starts or continues a run, and writes its agent at the end.

    Args:
        algorithm: name of the algorithm.
        folder: folder of the run.
        task: name of the task.
        kart_steps: number of kart-steps to learn from.
        seed: seed of all random numbers.
        **changes: other fields of :class:`TaskArguments` that differ from their defaults.

    Returns:
        The folder of the agent.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run.
    """
    check_whole("kart_steps", kart_steps, 1)
    arguments = TaskArguments(
        algorithm=algorithm, task=task, seed=seed, anneal_timesteps=kart_steps, **changes
    )
    if _ALGORITHMS[algorithm][0] != NOBODY:
        arguments = replace(arguments, keep_every=max(kart_steps // _POOL_SIZE, 1))
    learner = PPORun(folder, arguments, task_setup(arguments))
    return finish_run(learner, kart_steps, f"{algorithm}_{task}_{seed}")


def finish_run(learner: PPORun, kart_steps: int, name: str) -> Path:
    """Learns until a number of kart-steps, ends the races and writes the agent.

    Args:
        learner: the run.
        kart_steps: the number of kart-steps.
        name: name of the agent; becomes lower case, with underscores.

    Returns:
        The folder of the agent.
    """
    with closing(learner):
        policy = learner.learn(kart_steps, _SHOWN)
    plain = "".join(sign if sign.isalnum() else "_" for sign in name.lower())
    return export_policy(policy, plain, learner.folder / "agent", samples=True)
