"""The reference algorithms of the suite, by name.

stkzoo suite train versus ippo
"""

from __future__ import annotations

from pathlib import Path

from stkzoo.errors import check_whole

from .impala import IMPALA
from .learner import TaskLearner, finish_run
from .past import PastSelfPlay


class IPPO(TaskLearner):
    """Independent PPO: all learners share one policy, which learns from each kart's own reward.

    Policy and value network see the view of one kart; other learners are part of its environment
    (de Witt et al., 2020).
    """


class MAPPO(TaskLearner):
    """Multi-agent PPO: independent PPO whose value network sees the whole race (Yu et al., 2022).

    The inputs of the value network are a learner's observation and the state of the race
    (``env.state()``), scaled by fixed typical values. The trained agent does not need it.
    """

    sees_state = True


class FSP(PastSelfPlay):
    """Fictitious self-play: in half of the races, past policies drive some of the karts.

    Each of 40 past policies is equally likely, so that the learner finds a response to the mean of
    its past policies (Heinrich et al., 2015).
    """

    is_prioritized = False


class PFSP(PastSelfPlay):
    """Prioritized fictitious self-play: past policies that the learner beats least are likeliest.

    A past policy that is beaten with probability p is drawn with weight (1 - p)^2 (Vinyals et al.,
    2019). Each weight is 0.02 higher here, so that every policy can be drawn.
    """

    is_prioritized = True


_LEARNERS: dict[str, type[TaskLearner]] = {
    kind.__name__.lower(): kind for kind in (IPPO, MAPPO, FSP, PFSP, IMPALA)
}


def run(algorithm: str, folder: Path, task: str, kart_steps: int, seed: int) -> Path:
    """Starts or continues a run, and writes its agent at the end.

    Args:
        algorithm: name of the algorithm.
        folder: folder of the run.
        task: name of the task.
        kart_steps: number of kart-steps to learn from.
        seed: seed of all random numbers.

    Returns:
        The folder of the agent.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run.
    """
    check_whole("kart_steps", kart_steps, 1)
    kind = _LEARNERS[algorithm]
    learner = kind(folder, kind.arguments_of(task, kart_steps, seed))
    return finish_run(learner, kart_steps, f"{kind.__name__}_{task}_{seed}")
