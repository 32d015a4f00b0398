"""Shared parts of the reference algorithms: arguments, actors, figures and files of a run.

The folder of a run contains `checkpoint.pt`, `log.jsonl` (one line per iteration), TensorBoard
files, `arguments.json`, the saved policies, and at the end `agent`, the trained agent, and
`machine.json`, the machine that trained it.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo._os import cpu_count
from stkzoo._schema import Whole
from stkzoo.errors import ConfigError
from stkzoo.race.result import versions_now
from stkzoo.suite import Task, find_task

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import BatchSize, Coefficient, Natural, OverlappedArguments
from ..common.learner import RunFacts, train
from ..common.ppo import OverlappedPPO
from ..common.run_folder import write_json
from ..export import export_policy
from .actor import KartRace, TaskActor, reward_shares, rollout_type
from .network import TaskNetwork

#: File with the :class:`TrainingMachine` in the folder of a run.
MACHINE = "machine.json"
#: Figures of the log to show.
_SHOWN = ("return", "finished", "position", "entropy", "kl", "explained")


@dataclass(frozen=True, slots=True)
class TaskArguments(OverlappedArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        algorithm: name of the algorithm.
        task: name of the task.
        num_races: number of parallel races; 0 for as many as give 64 learners.
        num_starts: number of different starts in each process between two checkpoints.
    """

    learning_rate: float = 5e-4
    batch_size: BatchSize = 2048
    n_epochs: int = 4
    ent_coef: Coefficient = 0.01
    target_kl: float = 0.03
    warm_up: Natural = 0
    checkpoint_every: int = 40
    algorithm: str = "ippo"
    task: str = "solo-1"
    num_races: Natural = 0
    num_starts: int = 40


@dataclass(frozen=True, slots=True)
class TrainingMachine:
    """The machine that trained a run, or its last part if the run was continued on another one.

    Attributes:
        cores: number of its cores.
        versions: versions of its software by name.
    """

    cores: Whole
    versions: Mapping[str, str]

    @classmethod
    def now(cls) -> TrainingMachine:
        """Returns this machine."""
        return cls(cpu_count(), {**versions_now(), "torch": importlib.metadata.version("torch")})


@dataclass(frozen=True, slots=True)
class TaskFacts(RunFacts):
    """The facts in a checkpoint.

    Attributes:
        recent: the latest races of learners.
    """

    recent: tuple[KartRace, ...]


class TaskLearner(OverlappedPPO):
    """A run in a task, which learns by PPO unless a subclass has another ``_update``.

    See :class:`..common.ppo.OverlappedPPO`.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.

    Attributes:
        sees_state: whether the value network also sees the state of the whole race, in addition to
            the learner's observation.
        facts: type of the facts in a checkpoint.
        shown: figures of the log to show.

    Raises:
        ConfigError: this algorithm cannot learn the task, or the folder contains another run.
    """

    sees_state: ClassVar[bool] = False
    facts: ClassVar[type[TaskFacts]] = TaskFacts
    shown: ClassVar[tuple[str, ...]] = _SHOWN
    arguments: TaskArguments

    def __init__(self, folder: str | Path, arguments: TaskArguments) -> None:
        self.task = find_task(arguments.task)
        self.check_task(self.task)
        self._state_size = self.task.state_size if self.sees_state else 0
        super().__init__(folder, arguments, self.facts)

    @classmethod
    def arguments_of(cls, task: str, kart_steps: int, seed: int) -> TaskArguments:
        """Returns the arguments of a run.

        Args:
            task: name of the task.
            kart_steps: number of kart-steps to learn from.
            seed: seed of all random numbers.
        """
        return TaskArguments(
            algorithm=cls.__name__.lower(), task=task, seed=seed, anneal_timesteps=kart_steps
        )

    @classmethod
    def check_task(cls, task: Task) -> None:
        """Raises ``ConfigError`` if this algorithm cannot learn a task."""
        if task.words:
            raise ConfigError(
                f"{task.name} has messages, which the reference algorithms do not learn; write a "
                f"loop over its ParallelEnv, stkzoo.suite.find_task({task.name!r}).make()"
            )

    def _new_network(self) -> TaskNetwork:
        return TaskNetwork(self.arguments.hidden, self.arguments.seed, self._state_size)

    def _race_options(self) -> dict[str, Any]:
        """Returns the arguments of the races' environments."""
        return self.task.options()

    def _start_actors(self) -> tuple[ActorPool, list[npt.NDArray[np.void]]]:
        given, learners = self.arguments, self.task.learners
        races = given.num_races or max(64 // learners, 1)
        count = min(given.actors or cpu_count(), races)
        numbers = [len(range(number, races, count)) for number in range(count)]
        kind, shares = rollout_type(self._state_size), reward_shares(self.task)
        memories = [SharedArray((2, given.n_steps, own * learners), kind) for own in numbers]
        options = {"num_starts": given.num_starts, **self._race_options()}
        own_arguments = [
            ({"num_races": own, **options}, shares, memory)
            for own, memory in zip(numbers, memories, strict=True)
        ]
        return self._new_actors(own_arguments), [memory.array() for memory in memories]

    def _new_actors(self, arguments: list[tuple[Any, ...]]) -> ActorPool:
        """Starts actors, by the arguments of :class:`.actor.TaskActor`."""
        return ActorPool(TaskActor, arguments)

    def _figures(self) -> dict[str, float]:
        if not self._recent:
            return {}
        return {
            "return": fmean(race.reward for race in self._recent),
            "finished": fmean(race.is_finished for race in self._recent),
            "position": fmean(race.position for race in self._recent),
        }


def finish_run(learner: TaskLearner, kart_steps: int, name: str) -> Path:
    """Learns until a number of kart-steps, ends the races and writes the agent and the machine.

    If nothing is left to learn, the machine stays the one that trained.

    Args:
        learner: the run.
        kart_steps: the number of kart-steps.
        name: name of the agent; becomes lower case, with underscores.

    Returns:
        The folder of the agent.
    """
    is_trained = learner.kart_steps >= kart_steps
    with closing(learner):
        policy = train(learner, kart_steps, learner.shown)
    if not is_trained:
        write_json(learner.folder / MACHINE, asdict(TrainingMachine.now()))
    plain = "".join(sign if sign.isalnum() else "_" for sign in name.lower())
    return export_policy(policy, plain, learner.folder / "agent")
