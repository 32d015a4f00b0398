"""Independent PPO: every learner learns from its own observations and rewards, with one policy.

    stkzoo suite train versus ippo --output runs/versus

All learners of a task share one policy and one value network, which see the view `racing` of one
kart; other learners are part of its environment (de Witt et al., 2020). To continue a run, also
after a kill, repeat the command. The run continues bit for bit.

The folder contains `checkpoint.pt`, `log.jsonl` (one line per iteration), TensorBoard files,
`arguments.json`, the kept policies, and at the end `agent`, the trained agent:

    stkzoo suite evaluate versus runs/versus/agent
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import cpu_count
from stkzoo._schema import Count, Within
from stkzoo.errors import ConfigError
from stkzoo.suite import Task, find_task

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import OverlappedArguments
from ..common.ppo import OverlappedPPO, train
from ..export import export_policy
from .actor import ROLLOUT, Driven, Episode, TaskActor
from .network import TaskNetwork

#: Number of races in the means of the log.
_RECENT = 200
_SHOWN = ("return", "finished", "position", "entropy", "kl", "explained")


@dataclass(frozen=True, slots=True)
class IPPOArguments(OverlappedArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
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
    task: str = "solo-1"
    num_races: int = 0
    num_starts: int = 40


@dataclass(frozen=True, slots=True)
class TaskFacts:
    """The facts in a checkpoint.

    Attributes:
        history: the arguments, each with the kart-steps from which on they hold.
        kart_steps: driven by then.
        iteration: number of iterations by then.
        recent: the latest races of learners.
    """

    history: Annotated[list[dict[str, Any]], Within(1)]
    kart_steps: Count
    iteration: Count
    recent: tuple[Episode, ...]


class IPPO(OverlappedPPO):
    """A run of independent PPO in a task; see :class:`..common.ppo.OverlappedPPO`.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
    """

    def __init__(self, folder: str | Path, arguments: IPPOArguments) -> None:
        self.arguments, self.task = arguments, _learnable(arguments.task)
        self._recent: deque[Episode] = deque(maxlen=_RECENT)
        super().__init__(folder, arguments, TaskFacts)

    def _new_network(self) -> TaskNetwork:
        return TaskNetwork(self.arguments.hidden, self.arguments.seed)

    def _start_actors(self) -> tuple[ActorPool, list[npt.NDArray[np.void]]]:
        given, learners = self.arguments, self.task.learners
        races = given.num_races or max(64 // learners, 1)
        count = min(given.actors or cpu_count(), races)
        shares = [len(range(number, races, count)) for number in range(count)]
        memories = [SharedArray((2, given.n_steps, share * learners), ROLLOUT) for share in shares]
        actors = ActorPool(
            TaskActor,
            [
                (given.task, share, given.num_starts, memory)
                for share, memory in zip(shares, memories, strict=True)
            ],
        )
        return actors, [memory.array() for memory in memories]

    def _take(self, driven: Sequence[Driven]) -> None:
        for own in driven:
            self._recent.extend(own.episodes)

    def _figures(self) -> dict[str, float]:
        if not self._recent:
            return {}
        return {
            "return": fmean(episode.reward for episode in self._recent),
            "finished": fmean(episode.is_finished for episode in self._recent),
            "position": fmean(episode.position for episode in self._recent),
        }

    def _facts(self) -> dict[str, Any]:
        return {"recent": [asdict(episode) for episode in self._recent]}

    def _recall(self, facts: TaskFacts) -> None:
        self._recent.extend(facts.recent)


def _learnable(name: str) -> Task:
    task = find_task(name)
    if task.words:
        raise ConfigError(
            f"ippo does not learn {name}, which has messages; write a loop over its ParallelEnv, "
            f"stkzoo.suite.find_task({name!r}).make()"
        )
    return task


def run(folder: Path, task: str, kart_steps: int, seed: int) -> Path:
    """Starts or continues a run, and writes its agent at the end.

    Args:
        folder: folder of the run.
        task: name of the task.
        kart_steps: number of kart-steps to learn from.
        seed: seed of all random numbers.

    Returns:
        The folder of the agent.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run.
    """
    arguments = IPPOArguments(task=task, seed=seed, anneal_timesteps=kart_steps)
    with closing(IPPO(folder, arguments)) as learner:
        train(learner, kart_steps, arguments.keep_every, _SHOWN)
        policy = learner.save_policy()
    name = f"ippo_{task}_{seed}".replace("-", "_")
    return export_policy(policy, name, folder / "agent")
