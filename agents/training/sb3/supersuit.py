"""The same races through SuperSuit's vectorisation, for comparison: plain self-play, no rivals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import supersuit
from stable_baselines3.common.vec_env import VecEnvWrapper

from stkzoo import race_v0

from ..common.fleet import Lineup
from .races import SHORT_RACE, RaceEnd, way_and_places


class SuperSuitRaces(VecEnvWrapper):
    """Races in which the learner drives all karts, one after another within a step.

    Args:
        lineups: of the races; only those like the first are driven. Its bots drive too.
        tracks: drawn evenly.

    Attributes:
        kart_steps: how many steps there were, those of karts that had finished among them.
        rewarded: the sum of their rewards.
        ends: nothing; SuperSuit does not tell how a kart's race ended.
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
        self._inner = envs.venv  # SuperSuit's SB3 form hands on no seed
        self._seed: int | None = None
        self.kart_steps, self.rewarded = 0, 0.0
        self.ends: list[RaceEnd] = []
        super().__init__(envs)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds the next :meth:`reset`."""
        self._seed = seed
        return [seed] * self.num_envs

    def reset(self) -> npt.NDArray[np.float32]:
        """New races everywhere."""
        observations, _ = self._inner.reset(seed=self._seed)
        self._seed = None
        return np.asarray(observations)

    def step_wait(self) -> Any:
        """What came of a step."""
        step = self.venv.step_wait()
        self.kart_steps += self.num_envs
        self.rewarded += float(step[1].sum())
        return step

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector, for each slot; SuperSuit has no way to those of races."""
        found = getattr(self._inner, attr_name, None)
        return [found for _ in self._get_indices(indices)]

    def add_driver(self, name: str, driver: Any) -> None:
        """Takes note of no rival."""

    def close(self) -> None:
        """Ends the games."""
        for races in self._inner.vec_envs:
            races.close()
