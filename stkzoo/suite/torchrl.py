"""The tasks of the suite for TorchRL: races of a task as one batched environment.

>>> from stkzoo.suite import find_task
>>> from stkzoo.suite.torchrl import SuiteRaces
>>> env = SuiteRaces(find_task("team-2v2"), 2, seed=0)
>>> env.batch_size, env.group_map
(torch.Size([2]), {'team_0': ['kart_0', 'kart_3'], 'team_1': ['kart_1', 'kart_2']})
>>> env.close()

This module needs the ``benchmarl`` extra (in a checkout, ``pip install ".[benchmarl]"``).
``import stkzoo.suite`` does not import it.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.env.vec.starts import seeds_of_races
from stkzoo.errors import check_whole, import_extra, unknown_name
from stkzoo.suite.flat import ACTION_FORMS, CONTINUOUS, FlatTask
from stkzoo.suite.tasks import Task

import_extra("torchrl.envs", "stkzoo.suite.torchrl needs", "benchmarl")

import torch  # noqa: E402 - after the message about a missing library
from tensordict import TensorDict  # noqa: E402
from torchrl.data import Bounded, Categorical, Composite, Unbounded  # noqa: E402
from torchrl.envs import EnvBase  # noqa: E402

__all__ = ["SuiteRaces", "TaskOptions"]

#: Name of the group of all learners.
ALL_LEARNERS = "karts"
_DISCRETE_FORMS = tuple(form for form in ACTION_FORMS if form != CONTINUOUS)


@dataclass(frozen=True, slots=True)
class TaskOptions:
    """Options of a task: the ``config`` of :class:`~stkzoo.suite.benchmarl.SuiteTaskClass`.

    Attributes:
        actions: form of discrete actions: ``"few"`` or ``"all"``
            (:class:`~stkzoo.suite.FlatTask`).
        is_one_group: whether all learners form one group, with one policy. By default, each team is
            a group, and learners without teams form one.
        race: more arguments of :meth:`Task.make <stkzoo.suite.Task.make>`, such as ``max_cycles``.

    Raises:
        ConfigError: there is no such form.
    """

    actions: str = "few"
    is_one_group: bool = False
    race: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.actions not in _DISCRETE_FORMS:
            raise unknown_name("form of discrete actions", self.actions, _DISCRETE_FORMS)

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> TaskOptions:
        """Returns the options in a mapping.

        Raises:
            ConfigError: an option is unknown or invalid.
        """
        for name in config:
            if name not in cls.__dataclass_fields__:
                raise unknown_name("option of a task", name, cls.__dataclass_fields__)
        return cls(**config)

    def group_map(self, task: Task) -> dict[str, list[str]]:
        """Returns the agents of each group of a task."""
        if task.teams and not self.is_one_group:
            teams = enumerate(task.teams)
            return {f"team_{n}": [f"kart_{kart}" for kart in team] for n, team in teams}
        return {ALL_LEARNERS: [f"kart_{kart}" for kart in range(task.learners)]}


@dataclass(slots=True)
class _GroupArrays:
    """What the agents of a group get in one step, for R races of A agents.

    Attributes:
        observation: ``(R, A, size)`` float32; zeros for agents that are not in the race.
        mask: ``(R, A)`` bool, true for agents that race on.
        reward: ``(R, A, 1)`` float32.
        terminated: ``(R, A, 1)`` bool.
        truncated: ``(R, A, 1)`` bool.
    """

    observation: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    reward: npt.NDArray[np.float32]
    terminated: npt.NDArray[np.bool_]
    truncated: npt.NDArray[np.bool_]

    @classmethod
    def blank(cls, rows: tuple[int, int], size: int) -> _GroupArrays:
        """Returns arrays in which no agent is in the race."""
        column = (*rows, 1)
        return cls(
            np.zeros((*rows, size), np.float32),
            np.zeros(rows, np.bool_),
            np.zeros(column, np.float32),
            np.ones(column, np.bool_),
            np.zeros(column, np.bool_),
        )

    def tensors(self) -> dict[str, torch.Tensor]:
        """Returns all keys of the group."""
        arrays = {name: torch.from_numpy(getattr(self, name)) for name in self.__slots__}
        return {**arrays, "done": arrays["terminated"] | arrays["truncated"]}


class SuiteRaces(EnvBase):
    """Several races of a task at the same time, as a batched environment of TorchRL.

    Each group has the keys ``observation`` ``(races, agents, size)``, ``mask`` ``(races, agents)``,
    true for agents that race on, ``action``, ``reward``, ``done``, ``terminated`` and
    ``truncated``. Agents that have left the race have zeros as observations and rewards, and are
    terminated in each further step. The race is done when all have left; it is truncated if one
    of the last was. ``state`` is ``env.state()`` as ``sign(x) * log(1 + |x|)``, because its numbers
    have very different sizes.

    Threads step the races, so that their games run at the same time.

    Args:
        task: the task.
        num_races: number of races.
        is_continuous: whether actions are continuous.
        options: options of the task.
        seed: race ``n`` is seeded with ``seed + n``; ``None`` for no seed.
        device: device of the tensors.

    Attributes:
        races: the races.
        group_map: agents of each group.
        max_steps: maximum number of steps of a race.

    Raises:
        ConfigError: an option is invalid.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        task: Task,
        num_races: int,
        *,
        is_continuous: bool = False,
        options: TaskOptions | None = None,
        seed: int | None = None,
        device: Any = "cpu",
    ) -> None:
        check_whole("num_races", num_races, 1)
        options = options or TaskOptions()
        super().__init__(device=device, batch_size=[num_races])
        form = CONTINUOUS if is_continuous else options.actions
        self.group_map = options.group_map(task)
        self.races = [FlatTask(task.make(**options.race), actions=form) for _ in range(num_races)]
        race: Any = self.races[0].unwrapped
        self.max_steps: int | None = race.options.max_cycles
        self._threads = ThreadPoolExecutor(num_races, "stkzoo-race")
        self._set_seed(seed)
        self._make_specs(task.state_size)

    def _make_specs(self, state_size: int) -> None:
        count, first = len(self.races), self.races[0]
        seen: dict[str, Any] = {"state": Unbounded((count, state_size))}
        done: dict[str, Any] = _flags((count, 1))
        acted, rewarded = {}, {}
        for group, agents in self.group_map.items():
            rows, space = (count, len(agents)), first.action_space(agents[0])
            observation, mask = Unbounded((*rows, self._size)), _flag(rows)
            seen[group] = Composite(observation=observation, mask=mask, shape=rows)
            acted[group] = Composite(action=_action_spec(space, rows), shape=rows)
            rewarded[group] = Composite(reward=Unbounded((*rows, 1)), shape=rows)
            done[group] = Composite(**_flags((*rows, 1)), shape=rows)
        self.observation_spec, self.action_spec, self.reward_spec, self.done_spec = (
            Composite(**entries, shape=(count,)).to(self.device)
            for entries in (seen, acted, rewarded, done)
        )

    @property
    def _size(self) -> int:
        """Size of an observation."""
        race = self.races[0]
        shape = race.observation_space(race.possible_agents[0]).shape
        return int(np.prod(shape or ()))

    def _set_seed(self, seed: int | None) -> None:
        self._seeds = seeds_of_races(seed, len(self.races))

    def _reset(self, tensordict: Any = None, **_: Any) -> Any:
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        numbers = range(len(self.races)) if chosen is None else chosen.nonzero()[:, 0].tolist()
        groups = self._blank()
        for own in groups.values():
            own.terminated[:] = False
        list(self._threads.map(partial(self._reset_race, groups), numbers))
        tensors = self._tensors(groups)
        return tensors.exclude(*self.reward_keys)

    def _reset_race(self, groups: Mapping[str, _GroupArrays], number: int) -> None:
        seed, self._seeds[number] = self._seeds[number], None
        observations, _ = self.races[number].reset(seed=seed)
        self._write_observations(groups, number, observations)

    def _step(self, tensordict: Any) -> Any:
        actions = {group: tensordict[group, "action"].cpu().numpy() for group in self.group_map}
        groups = self._blank()
        list(self._threads.map(partial(self._step_race, groups, actions), range(len(self.races))))
        return self._tensors(groups)

    def _step_race(
        self,
        groups: Mapping[str, _GroupArrays],
        actions: Mapping[str, npt.NDArray[Any]],
        number: int,
    ) -> None:
        race = self.races[number]
        own = {
            agent: actions[group][number, row]
            for group, agents in self.group_map.items()
            for row, agent in enumerate(agents)
            if agent in race.agents
        }
        observations, rewards, terminations, truncations, _ = race.step(own)
        self._write_observations(groups, number, observations)
        for group, agents in self.group_map.items():
            arrays = groups[group]
            for row, agent in enumerate(agents):
                if agent in own:
                    arrays.reward[number, row] = rewards[agent]
                    arrays.terminated[number, row] = terminations[agent]
                    arrays.truncated[number, row] = truncations[agent]

    def _write_observations(
        self, groups: Mapping[str, _GroupArrays], number: int, observations: Mapping[str, Any]
    ) -> None:
        racing = self.races[number].agents
        for group, agents in self.group_map.items():
            arrays = groups[group]
            for row, agent in enumerate(agents):
                arrays.mask[number, row] = agent in racing
                if agent in observations:
                    arrays.observation[number, row] = observations[agent]

    def _blank(self) -> dict[str, _GroupArrays]:
        count = len(self.races)
        return {
            group: _GroupArrays.blank((count, len(agents)), self._size)
            for group, agents in self.group_map.items()
        }

    def _tensors(self, groups: Mapping[str, _GroupArrays]) -> Any:
        tensors = {group: own.tensors() for group, own in groups.items()}
        done, truncated = (
            torch.cat([own[name] for own in tensors.values()], dim=1)
            for name in ("done", "truncated")
        )
        is_over, is_cut = done.all(dim=1), truncated.any(dim=1)
        state = torch.from_numpy(np.stack([race.state() for race in self.races]))
        parts = {
            group: TensorDict(own, batch_size=own["mask"].shape) for group, own in tensors.items()
        }
        return TensorDict(
            {
                **parts,
                "state": state.sign() * state.abs().log1p(),
                "done": is_over,
                "terminated": is_over & ~is_cut,
                "truncated": is_over & is_cut,
            },
            batch_size=self.batch_size,
        ).to(self.device)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Closes all races.

        Args:
            raise_if_closed: whether a second call raises an error.
        """
        super().close(raise_if_closed=raise_if_closed)
        self._threads.shutdown()
        for race in self.races:
            race.close()


def _flag(shape: tuple[int, ...]) -> Categorical:
    return Categorical(2, shape=shape, dtype=torch.bool)


def _flags(shape: tuple[int, ...]) -> dict[str, Categorical]:
    return {name: _flag(shape) for name in ("done", "terminated", "truncated")}


def _action_spec(space: spaces.Space[Any], rows: tuple[int, int]) -> Any:
    """Returns TorchRL's form of the space of an action, for rows of agents."""
    if isinstance(space, spaces.Discrete):
        return Categorical(int(space.n), shape=rows, dtype=torch.int64)
    return Bounded(-1.0, 1.0, (*rows, *(space.shape or ())), dtype=torch.float32)
