"""The four tasks of stkzoo-suite-1: what agents learn, on which tracks, and how they are evaluated.

A task never changes. :attr:`Task.digest` identifies its definition; another definition is another
suite.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import gymnasium as gym
import pettingzoo
from pettingzoo import ParallelEnv

from stkzoo._checks import check_name
from stkzoo._schema import Count, Whole, one_of
from stkzoo.config import AgentSpec
from stkzoo.env.ids import MAX_EPISODE_STEPS
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.evaluation.benchmark.races import BenchmarkForm
from stkzoo.tracks import TEST_TRACKS, TRAIN_TRACKS
from stkzoo.views import ViewFactory, find_view
from stkzoo.wrappers.marl import Teams

#: Name of the suite, with its version.
SUITE = "stkzoo-suite-1"
_NAMESPACE = "stkzoo-suite"
#: Difficulty of the races, where the population does not require another one. Time limits and
#: time ratios use the AI's times at this difficulty in all races.
DIFFICULTY = 3
_SEVERAL, _TEAMS = "several learners", "teams"
#: Reference algorithms (``stkzoo.agents.training.suite.algorithms``), and what their tasks must
#: have; empty for nothing.
ALGORITHMS = {"ippo": "", "mappo": _SEVERAL, "pfsp": _SEVERAL, "recurrent": "", "blind": _TEAMS}
#: Metrics by which tasks are ranked.
TIME_RATIO, BEATEN = "time_ratio", "beaten"


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A task: an environment to learn in, a budget, and the races of the evaluation.

    All races have one lap. Tracks are driven forward and in reverse.

    Attributes:
        name: name of the task.
        goal: description in one sentence.
        train_tracks: tracks to learn on.
        test_tracks: tracks of the evaluation.
        learners: number of karts that learn.
        rivals: number of karts of the game's hardest AI during learning.
        view: view of the learners.
        reward: reward of the learners.
        teams: numbers of the learners of each team; empty without teams. A team shares its rewards.
        forms: race forms of the evaluation (:class:`~stkzoo.evaluation.BenchmarkForm`): ``P`` is a
            kart of the agent, ``A`` of the game's hardest AI, ``B`` of the population.
        seeds: races for each form, end of the grid, track and direction.
        metric: metric of the score: ``"time_ratio"`` or ``"beaten"``
            (:class:`~stkzoo.evaluation.RaceOutcome`).
        budget: number of kart-steps to learn from.
        long_budget: number of kart-steps of the long tier.
    """

    name: str
    goal: str
    train_tracks: tuple[str, ...] = TRAIN_TRACKS
    test_tracks: tuple[str, ...] = TEST_TRACKS
    learners: Whole
    rivals: Count = 0
    view: str = "contest"
    reward: str = "race"
    teams: tuple[tuple[Count, ...], ...] = ()
    forms: tuple[str, ...]
    seeds: Whole
    metric: Annotated[str, one_of(TIME_RATIO, BEATEN)] = BEATEN
    budget: Whole = 1_000_000
    long_budget: Whole = 10_000_000

    @property
    def digest(self) -> str:
        """SHA-256 of the definition, including the suite's name and all defaults."""
        text = json.dumps({"suite": SUITE, **asdict(self)}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def num_kart(self) -> int:
        """Number of karts of a race during learning."""
        return self.learners + self.rivals

    @property
    def has_population(self) -> bool:
        """Whether drivers of the population race in the evaluation."""
        return any(BenchmarkForm.of(form).has_population for form in self.forms)

    @property
    def num_races(self) -> int:
        """Number of races of the evaluation."""
        ends = sum(len(BenchmarkForm.of(form).ends) for form in self.forms)
        return len(self.test_tracks) * 2 * ends * self.seeds

    def places(self) -> list[list[AgentSpec]]:
        """Returns the learners' places on the grid and teams, once for each end of the grid.

        As in the evaluation, learners with rivals start at the front or at the back. Members of a
        team start next to each other.
        """
        team_of = {agent: number for number, team in enumerate(self.teams) for agent in team}
        firsts = [0, self.rivals] if self.rivals else [0] if self.teams else [None]
        return [
            [
                AgentSpec(None if first is None else first + agent, team=team_of.get(agent))
                for agent in range(self.learners)
            ]
            for first in firsts
        ]

    def options(self, split: str = "train") -> dict[str, Any]:
        """Returns the task's arguments of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

        :class:`~stkzoo.RaceVectorEnv` and :class:`~stkzoo.sb3.RaceVecEnv` take the same arguments.

        Args:
            split: ``"train"`` for the tracks to learn on, ``"test"`` for those of the evaluation.

        Raises:
            ConfigError: there is no such split.
        """
        tracks = {"train": self.train_tracks, "test": self.test_tracks}
        check_name("split", split, tracks)
        return {
            "num_kart": self.num_kart,
            "agents": self.places()[0] if self.teams else self.learners,
            "track": tracks[split],
            "reverse": None,
            "difficulty": DIFFICULTY,
            "view": self.view,
            "reward": self.reward,
        }

    def make(self, split: str = "train", **options: Any) -> ParallelEnv[str, Any, Any]:
        """Returns the task's environment, with its teams.

        Args:
            split: as for :meth:`options`.
            **options: more arguments of :class:`~stkzoo.env.parallel.RaceParallelEnv`, such as
                ``render_mode``. Other tracks, karts, views or rewards make another task.

        Raises:
            ConfigError: an argument is invalid.
            AssetError: the game's data is missing.
        """
        env: ParallelEnv[str, Any, Any] = RaceParallelEnv(**{**self.options(split), **options})
        if self.teams:
            env = Teams(env)
        return env


#: The tasks by name.
TASKS = {
    task.name: task
    for task in (
        Task(
            name="solo-general",
            goal="Drive alone on tracks that were never seen.",
            learners=1,
            forms=("P",),
            seeds=5,
            metric=TIME_RATIO,
        ),
        Task(
            name="versus",
            goal="Beat four karts of the game's hardest AI.",
            learners=1,
            rivals=4,
            forms=("PAAAA",),
            seeds=5,
        ),
        Task(
            name="selfplay-5",
            goal="Learn among five learners, and race against drivers of other kinds.",
            learners=5,
            forms=("PBBBB", "PPPPB"),
            seeds=3,
        ),
        Task(
            name="team-2v2",
            goal="Win as a team of two that shares its rewards.",
            learners=4,
            teams=((0, 1), (2, 3)),
            forms=("PPBB",),
            seeds=5,
        ),
    )
}


def find_task(name: str) -> Task:
    """Returns the task with a name.

    Raises:
        ConfigError: there is no such task.
    """
    check_name("task", name, TASKS)
    return TASKS[name]


def can_learn(algorithm: str, task: Task) -> bool:
    """Returns whether an algorithm can learn a task; true for all other algorithms.

    Args:
        algorithm: name of the algorithm.
        task: the task.
    """
    needs = ALGORITHMS.get(algorithm)
    return bool(task.teams) if needs == _TEAMS else not needs or task.learners > 1


# ------------------------------------------------------------------ ids


def id_of(task: Task) -> str:
    """Returns the id of a task."""
    return f"{_NAMESPACE}/{task.name}-v1"


def view_of(env_id: str) -> ViewFactory:
    """Returns the view of the agents of the task with an id.

    Raises:
        ConfigError: no task has this id.
    """
    tasks = {id_of(task): task for task in TASKS.values()}
    check_name("env_name", env_id, tasks)
    return find_view(tasks[env_id].view)


def register_tasks() -> None:
    """Registers all tasks; ``import stkzoo.suite`` calls it.

    Gymnasium gets those with one learner, and PettingZoo all, from its version 1.27.
    """
    for task in TASKS.values():
        if task.learners == 1:
            options = {name: value for name, value in task.options().items() if name != "agents"}
            gym.register(
                id=id_of(task),
                entry_point="stkzoo.env.gymnasium_api:STKRaceEnv",
                vector_entry_point="stkzoo.env.vector:single_kart_races",
                kwargs=options,
                max_episode_steps=MAX_EPISODE_STEPS,
            )
        if hasattr(pettingzoo, "register"):
            pettingzoo.register("parallel", id_of(task), task.make)
