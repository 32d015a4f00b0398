"""What the reference algorithms share: arguments, actors, figures and files of a run.

The folder of a run contains `checkpoint.pt`, `log.jsonl` (one line per iteration), TensorBoard
files, `arguments.json`, the kept policies, and at the end `agent`, the trained agent.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo._os import cpu_count
from stkzoo.errors import ConfigError
from stkzoo.suite import Task, find_task

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import OverlappedArguments
from ..common.ppo import OverlappedPPO, RunFacts, train
from ..export import export_policy
from .actor import KartRace, TaskActor, rollout_type
from .network import TaskNetwork

_SHOWN = ("return", "finished", "position", "entropy", "kl", "explained")


@dataclass(frozen=True, slots=True)
class TaskArguments(OverlappedArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        algorithm: name of the algorithm.
        task: name of the task.
        num_races: number of parallel races; 0 is as many as have 64 learners.
        num_starts: number of different starts in each process between two checkpoints.
    """

    may_be_zero = ("seed", "warm_up", "actors", "num_races")

    learning_rate: float = 5e-4
    batch_size: int = 2048
    n_epochs: int = 4
    ent_coef: float = 0.01
    target_kl: float = 0.03
    warm_up: int = 0
    checkpoint_every: int = 40
    algorithm: str = "ippo"
    task: str = "solo-1"
    num_races: int = 0
    num_starts: int = 40


@dataclass(frozen=True, slots=True)
class TaskFacts(RunFacts):
    """The facts in a checkpoint.

    Attributes:
        recent: the latest races of learners.
    """

    recent: tuple[KartRace, ...]


class TaskLearner(OverlappedPPO):
    """A run of PPO in a task; see :class:`..common.ppo.OverlappedPPO`.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.

    Attributes:
        sees_state: whether the value network sees the state of the whole race besides the
            learner's observation.

    Raises:
        ConfigError: the task cannot be learned by this, or the folder contains another run.
    """

    sees_state: ClassVar[bool] = False
    arguments: TaskArguments

    def __init__(self, folder: str | Path, arguments: TaskArguments) -> None:
        self.task = _learnable(arguments.task)
        self._state_size = self.task.state_size if self.sees_state else 0
        super().__init__(folder, arguments, TaskFacts)

    def _new_network(self) -> TaskNetwork:
        return TaskNetwork(self.arguments.hidden, self.arguments.seed, self._state_size)

    def _start_actors(self) -> tuple[ActorPool, list[npt.NDArray[np.void]]]:
        given, learners = self.arguments, self.task.learners
        races = given.num_races or max(64 // learners, 1)
        count = min(given.actors or cpu_count(), races)
        shares = [len(range(number, races, count)) for number in range(count)]
        kind = rollout_type(self._state_size)
        memories = [SharedArray((2, given.n_steps, share * learners), kind) for share in shares]
        actors = ActorPool(
            TaskActor,
            [
                (given.task, share, given.num_starts, memory)
                for share, memory in zip(shares, memories, strict=True)
            ],
        )
        return actors, [memory.array() for memory in memories]

    def _figures(self) -> dict[str, float]:
        if not self._recent:
            return {}
        return {
            "return": fmean(race.reward for race in self._recent),
            "finished": fmean(race.is_finished for race in self._recent),
            "position": fmean(race.position for race in self._recent),
        }


def _learnable(name: str) -> Task:
    task = find_task(name)
    if task.words:
        raise ConfigError(
            f"{name} has messages, which the reference algorithms do not learn; write a loop over "
            f"its ParallelEnv, stkzoo.suite.find_task({name!r}).make()"
        )
    return task


def run_task(kind: type[TaskLearner], folder: Path, task: str, kart_steps: int, seed: int) -> Path:
    """Starts or continues a run, and writes its agent at the end.

    Args:
        kind: the algorithm.
        folder: folder of the run.
        task: name of the task.
        kart_steps: number of kart-steps to learn from.
        seed: seed of all random numbers.

    Returns:
        The folder of the agent.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run.
    """
    algorithm = kind.__name__.lower()
    arguments = TaskArguments(
        algorithm=algorithm, task=task, seed=seed, anneal_timesteps=kart_steps
    )
    with closing(kind(folder, arguments)) as learner:
        policy = train(learner, kart_steps, _SHOWN)
    name = f"{algorithm}_{task}_{seed}".replace("-", "_")
    return export_policy(policy, name, folder / "agent")
