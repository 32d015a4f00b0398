"""Many races as one Stable-Baselines3 ``VecEnv``."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from stkzoo.env.vec.env import RaceVectorEnv
from stkzoo.env.vec.slots import SlotSteps
from stkzoo.env.vec.starts import seeds_of_races
from stkzoo.errors import ConfigError

Indices = None | int | Iterable[int]


class RaceVecEnv(VecEnv):
    """A Stable-Baselines3 ``VecEnv`` in which every agent of every race is one environment.

    It wraps :class:`~stkzoo.env.vec.env.RaceVectorEnv`, which documents slots, episode ends and
    crashes. A slot is *idle* after its agent has finished while other agents of its race still
    drive. An idle slot reports ``done`` in every step, with an all-zero observation and no reward:
    each of its steps is an episode of length one, so no value is bootstrapped between idle and real
    steps. To exclude idle steps from updates, pass
    ``rollout_buffer_class=ActiveDictRolloutBuffer`` to the algorithm (or
    :class:`~stkzoo.sb3.ActiveRolloutBuffer` if observations are a ``Box``). Idle steps still count
    as timesteps.

    **Infos** are one dict per slot: the agent's own entries, ``active`` and ``track``. At the end
    of an episode they also hold ``terminal_observation``, ``TimeLimit.truncated`` and ``episode``
    (return ``r``, length ``l``, and time ``t`` since construction [s]). Stable-Baselines3 logs its
    means from ``episode``, without a ``VecMonitor``.

    Args:
        num_races: number of races.
        view: see :class:`~stkzoo.env.vec.env.RaceVectorEnv`. Actions must be a single array, as in
            ``flattened_discrete``, ``flattened_multidiscrete`` and
            ``flattened_continuous_actions``.
        prefetch: see :class:`~stkzoo.env.vec.env.RaceVectorEnv`.
        num_starts: likewise.
        **options: options of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        races: the same races as a Gymnasium vector environment. Use it for inspection only; step
            the races through this object.

    Raises:
        ConfigError: an argument is invalid, or Stable-Baselines3 does not support the view's
            actions.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        num_races: int = 1,
        *,
        view: Any = "flattened_discrete",
        prefetch: bool | None = None,
        num_starts: int | None = None,
        **options: Any,
    ) -> None:
        self.races = RaceVectorEnv(
            num_races, view=view, prefetch=prefetch, num_starts=num_starts, **options
        )
        actions = self.races.single_action_space
        if not isinstance(
            actions, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
        ):
            self.races.close()
            raise ConfigError(
                f"the view {view!r} acts by a {type(actions).__name__}; Stable-Baselines3 needs "
                "an array: choose flattened_discrete, flattened_multidiscrete or "
                "flattened_continuous_actions"
            )
        self._race_seeds: list[int | None] = [None] * num_races
        self._born = time.monotonic()
        super().__init__(self.races.num_envs, self.races.single_observation_space, actions)

    @property
    def num_crashes(self) -> int:
        """Number of times the game crashed or hung, over all races."""
        return self.races.num_crashes

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds the next :meth:`reset`: race ``n`` gets ``seed + n``.

        Args:
            seed: a whole number; ``None`` draws one from numpy's global random state, as
                Stable-Baselines3 does.

        Returns:
            The seed of each slot's race.
        """
        if seed is None:
            seed = int(np.random.randint(0, np.iinfo(np.uint32).max, dtype=np.uint32))
        self._race_seeds = seeds_of_races(seed, self.races.num_races)
        return [seed for seed in self._race_seeds for _ in range(self.races.num_agents)]

    def reset(self) -> Any:
        """Starts a new race in every environment and stores the infos in ``reset_infos``.

        Options from ``set_options`` hold for one episode. All slots of a race need the same ones.
        For options that hold until you change them, call ``races.set_options``.

        Returns:
            Observations of all slots.

        Raises:
            ConfigError: an option is invalid, or slots of one race have different options.
        """
        seeds, self._race_seeds = self._race_seeds, [None] * self.races.num_races
        by_slot, count = [dict(options or {}) for options in self._options], self.races.num_agents
        self._reset_options()
        if len(by_slot) != self.num_envs:
            raise ConfigError(
                f"there are options for {len(by_slot)} slots, expected a dict or a list of "
                f"{self.num_envs}, one per slot"
            )
        options = by_slot[::count]
        for slot, slot_options in enumerate(by_slot):
            if slot_options != options[slot // count]:
                raise ConfigError(
                    f"the options of slots {slot // count * count} and {slot} differ, but both "
                    "are in one race; give all slots of a race the same options"
                )
        steps = self.races.reset_slots(seeds, options)
        self.reset_infos = self._infos(steps)
        return steps.observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step of all races and returns before it is done.

        Args:
            actions: one action per slot; actions of idle slots are ignored.
        """
        self.races.step_async(actions)

    def step_wait(
        self,
    ) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Waits for the step that :meth:`step_async` started.

        Returns:
            Observations, rewards ``(num_envs,)`` float32, dones ``(num_envs,)`` bool, and infos.
        """
        steps = self.races.wait_slots()
        done = steps.terminations | steps.truncations | ~steps.active
        infos = self._infos(steps)
        for slot in np.flatnonzero(done).tolist():
            if infos[slot]["active"]:  # the slot's race has started again
                self.reset_infos[slot] = infos[slot]
            infos[slot] = self._ended(steps, slot)
        return steps.observations, steps.rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Stops the game processes."""
        self.races.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Returns an attribute of each slot's race, a ``RaceParallelEnv``."""
        return [getattr(self._race(slot), attr_name) for slot in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Sets an attribute, such as ``max_cycles``, on the race of each selected slot."""
        for slot in self._get_indices(indices):
            setattr(self._race(slot), attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Calls a method once per race of the selected slots; returns its result per slot."""
        numbers = [slot // self.races.num_agents for slot in self._get_indices(indices)]
        results = {
            number: getattr(self.races.races[number], method_name)(*method_args, **method_kwargs)
            for number in dict.fromkeys(numbers)
        }
        return [results[number] for number in numbers]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Indices = None
    ) -> list[bool]:
        """Returns, per slot, whether it has this wrapper.

        The answer is ``True`` for ``Monitor`` only, because the infos include what it records.
        """
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]

    def _race(self, slot: int) -> Any:
        return self.races.races[slot // self.races.num_agents]

    def _infos(self, steps: SlotSteps) -> list[dict[str, Any]]:
        """Returns the info of each slot for its observation; of an idle slot, only its track."""
        infos = steps.infos.dicts()
        for info, number in zip(infos, steps.tracks.tolist(), strict=True):
            info.update(track=self.races.tracks[number], active=bool(info))
        return infos

    def _ended(self, steps: SlotSteps, slot: int) -> dict[str, Any]:
        """Returns the info of a slot whose episode ended in this step, or which is idle."""
        last, info = steps.finals.get(slot) or (copy.deepcopy(self.races.idle_observation), {})
        age = round(time.monotonic() - self._born, 6)
        episode = {"episode": {**info["episode"], "t": age}} if "episode" in info else {}
        return {
            "track": self.races.tracks[steps.tracks[slot]],
            **info,
            **episode,
            "active": bool(steps.active[slot]),
            "terminal_observation": last,
            "TimeLimit.truncated": bool(steps.truncations[slot]),
        }
