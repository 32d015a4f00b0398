"""The same races through SuperSuit, for comparison: plain self-play without rivals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import supersuit
from stable_baselines3.common.vec_env import VecEnvWrapper

from stkzoo import race_v0

from ..common.starts import Lineup
from .races import SHORT_RACE, RaceEnd, way_and_places


class SuperSuitRaces(VecEnvWrapper):
    """Races in which the learner drives all karts, stepped one after another.

    Args:
        lineups: lineups of the races; only those equal to the first are used, including its bots.
        tracks: tracks, drawn uniformly.

    Attributes:
        kart_steps: number of steps, including those of karts that have finished.
        rewarded: sum of their rewards.
        ends: always empty; SuperSuit does not report how a kart's race ended.
    """

    def __init__(self, lineups: Sequence[Lineup], tracks: tuple[str, ...]) -> None:
        first = lineups[0]
        self.num_races = lineups.count(first)
        race = race_v0.parallel_env(
            agents=first.learners,
            num_kart=first.learners + first.bots,
            track=tracks,
            view="racing",
            reward=way_and_places(),
            start="random",
            max_cycles=SHORT_RACE,
        )
        races = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(race))
        envs = supersuit.concat_vec_envs_v1(
            races, self.num_races, num_cpus=0, base_class="stable_baselines3"
        )
        self._inner = envs.venv  # SuperSuit's SB3 wrapper does not forward seeds
        self._seed: int | None = None
        self.kart_steps, self.rewarded = 0, 0.0
        self.ends: list[RaceEnd] = []
        super().__init__(envs)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds the next :meth:`reset`."""
        self._seed = seed
        return [seed] * self.num_envs

    def reset(self) -> npt.NDArray[np.float32]:
        """Starts new races."""
        observations, _ = self._inner.reset(seed=self._seed)
        self._seed = None
        return np.asarray(observations)

    def step_wait(self) -> Any:
        """Waits for the step and returns its results."""
        step = self.venv.step_wait()
        self.kart_steps += self.num_envs
        self.rewarded += float(step[1].sum())
        return step

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns an attribute of the vector environment per slot; races are not accessible."""
        found = getattr(self._inner, attr_name, None)
        return [found for _ in self._get_indices(indices)]

    def add_driver(self, name: str, driver: Any) -> None:
        """Ignores the driver, because there are no rivals."""

    def close(self) -> None:
        """Stops the game processes."""
        for races in self._inner.vec_envs:
            races.close()
