"""Self-play races as one ``VecEnv`` with learners, frozen rivals and bots.

In some races the learner drives all agents; in the others a frozen rival drives half of them. For
Stable-Baselines3, a rival's slot is idle: each of its steps is an episode without reward, which
:class:`stkzoo.sb3.ActiveRolloutBuffer` excludes from updates. A rival can therefore use other slots
in the next race.

The finish counts as a truncation, because the road continues behind the line and a kart does not
observe its distance to the line. If the finish were terminal, the value would drop to zero
unpredictably in the last seconds, by far more than the difference between good and bad driving.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from stkzoo import RandomStart, Reward
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, ActionFilter
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.errors import ConfigError
from stkzoo.sb3 import RaceVecEnv

from ..common.fleet import ai_time
from ..common.opponents import RivalPool, bot_name
from ..common.starts import Lineup
from .curriculum import Curriculum

Indices = None | int | Iterable[int]

#: Duration of a step and of the countdown before GO [s].
STEP, COUNTDOWN = 0.1, 2.0
#: Time limit of a race, as a multiple of the AI's median time.
PATIENCE = 2.0
#: Number of steps of a race that does not start on the grid.
SHORT_RACE = 250
#: Longest distance per step [m]; a longer one is a jump of the game's distance off the road.
_LONGEST_STEP = 5.0


@dataclass(frozen=True, slots=True)
class RaceEnd:
    """The result of a learner's kart.

    Attributes:
        track: name of the track.
        rival: the other driver: a snapshot, ``bot:0`` to ``bot:3``, or empty for none.
        beaten: fraction of the rival's karts that the learner's kart was ahead of; ``None`` without
            a rival.
        pace: mean speed over that of the game's AI in such races.
        finished: whether the kart finished.
        steps: number of steps it drove.
    """

    track: str
    rival: str
    beaten: float | None
    pace: float
    finished: bool
    steps: int


def way_and_places() -> Reward:
    """Returns the reward: 0.1 per meter driven, and 0.3 per place gained."""

    def meters(step: Any) -> Any:
        driven = step.distance - step.distance_before
        return np.where(np.abs(driven) > _LONGEST_STEP, 0.0, driven) / 10.0

    def places(step: Any) -> Any:
        return 0.3 * (step.before.karts["position"] - step.position.astype(np.float64))

    return Reward({"meters": meters, "places": places})


class _SelfPlayRace:
    """Successive races: drivers of the current one, and options of the next one."""

    def __init__(self, env: Any, lineup: Lineup, first: int) -> None:
        self.env, self.lineup = env, lineup
        self.slots = slice(first, first + lineup.learners)
        self.rival = ""
        self.is_learner = np.ones(lineup.learners, bool)
        self.ended = np.zeros(lineup.learners, bool)
        self.finals: list[dict[str, Any]] = [{}] * lineup.learners
        self.from_grid = self.next_from_grid = True
        self.begin_at = np.zeros(lineup.learners)

    def begin(self, infos: Sequence[dict[str, Any]]) -> None:
        self.ended[:] = False
        self.from_grid = self.next_from_grid
        self.begin_at = np.array([info["distance"] for info in infos])
        self.rival, self.is_learner = "", np.ones(self.lineup.learners, bool)
        if self.lineup.bots:
            self.rival = bot_name(self.env.race.difficulty)
        race = self.env.race
        self._ai_speed = self.env.track_map.length / ai_time(
            race.track, race.reverse, race.difficulty
        )
        self._track = race.track

    def face(self, rival: str, random: np.random.Generator) -> None:
        """Assigns half of the karts to a rival."""
        self.rival = rival
        self.is_learner[random.permutation(len(self.is_learner))[: len(self.is_learner) // 2]] = 0

    def ends(self) -> list[RaceEnd]:
        """Returns the results of the learner's karts, once all have ended."""
        places = np.array([info["position"] for info in self.finals])
        ends = []
        for row in np.flatnonzero(self.is_learner):
            info = self.finals[row]
            steps = int(info["episode/length"])
            seconds = max(STEP * steps - COUNTDOWN * self.from_grid, STEP)
            way = max(float(info["distance"]) - self.begin_at[row], 0.0)
            ends.append(
                RaceEnd(
                    track=self._track,
                    rival=self.rival,
                    beaten=self._beaten(int(row), places),
                    pace=min(way / seconds / self._ai_speed, 2.0),
                    finished=float(info["finish_time"]) > 0,
                    steps=steps,
                )
            )
        return ends

    def _beaten(self, row: int, places: npt.NDArray[Any]) -> float | None:
        if self.lineup.bots:
            before = places[row] - 1 - int((places < places[row]).sum())
            return float(np.clip(1.0 - before / self.lineup.bots, 0.0, 1.0))
        rivals = places[~self.is_learner]
        return float((places[row] < rivals).mean()) if len(rivals) else None


class SelfPlayVecEnv(VecEnv):
    """Self-play races; each race is drawn from the curriculum and the opponent pools.

    Args:
        lineups: lineup of each race.
        curriculum: determines tracks, directions and difficulties; updated with the results.
        bots: the game's bots as opponents; updated with the results.
        snapshots: the frozen opponents; updated with the results.
        snapshot_share: fraction of races without bots in which a snapshot drives half of the karts.
        grid_share: fraction of races that start on the grid; the others start anywhere on the
            track.
        hold: minimum steps of a drift, for all drivers.

    Attributes:
        kart_steps: number of steps that the learner has driven.
        rewarded: sum of its rewards.
        ends: results of the learner's karts; the reader empties the list.

    Raises:
        ConfigError: a lineup is invalid.
    """

    def __init__(
        self,
        lineups: Sequence[Lineup],
        curriculum: Curriculum,
        bots: RivalPool,
        snapshots: RivalPool,
        *,
        snapshot_share: float = 0.5,
        grid_share: float = 0.3,
        hold: int = 0,
    ) -> None:
        self._curriculum, self._bots, self._snapshots = curriculum, bots, snapshots
        self._snapshot_share, self._grid_share = snapshot_share, grid_share
        self._drivers: dict[str, MlpDriver] = {}
        self._envs: list[RaceVecEnv] = []
        self._races: list[_SelfPlayRace] = []
        first = 0
        reward = way_and_places()
        for lineup, own in itertools.groupby(lineups):
            env = RaceVecEnv(
                len([*own]),
                agents=lineup.learners,
                num_kart=lineup.learners + lineup.bots,
                track=curriculum.tracks[0],
                view="racing",
                reward=reward,
                prefetch=False,  # the next race depends on the results
            )
            self._envs.append(env)
            for race in env.races.races:
                self._races.append(_SelfPlayRace(race, lineup, first))
                first += lineup.learners
        self._cuts = np.cumsum([env.num_envs for env in self._envs])[:-1].tolist()
        self._random = np.random.default_rng()
        self._action_filter = ActionFilter(first, hold)
        self.kart_steps, self.rewarded = 0, 0.0
        self.ends: list[RaceEnd] = []
        self._observations = np.zeros((first, INPUT_SIZE), np.float32)
        space = spaces.Box(-np.inf, np.inf, (INPUT_SIZE,), np.float32)
        super().__init__(first, space, self._envs[0].action_space)

    @property
    def num_races(self) -> int:
        """Number of parallel races."""
        return len(self._races)

    def add_driver(self, name: str, driver: MlpDriver) -> None:
        """Adds the driver of a snapshot in the pool."""
        self._drivers[name] = driver

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds all random numbers from the next :meth:`reset` on."""
        self._random = np.random.default_rng(seed)
        for env in self._envs:
            env.seed(int(self._random.integers(2**31)))
        return [seed] * self.num_envs

    def reset(self) -> npt.NDArray[np.float32]:
        """Starts new races; returns the observations of all slots."""
        for race in self._races:
            self._plan(race)
        views = np.concatenate([np.asarray(env.reset()) for env in self._envs])
        infos = [info for env in self._envs for info in env.reset_infos]
        for race in self._races:
            self._begin(race, infos[race.slots])
        self._observations = self._action_filter.see(views)
        self._reset_seeds()
        self._reset_options()
        return self._observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step with the learner's actions for its karts; rivals choose their own."""
        chosen = np.array(actions)
        for race in self._races:
            if not race.is_learner.all():
                rows = np.flatnonzero(~race.is_learner) + race.slots.start
                driver = self._drivers[race.rival]
                chosen[rows] = driver.sample(self._observations[rows], self._random)
        done = self._action_filter.apply(chosen)
        for env, part in zip(self._envs, np.split(done, self._cuts), strict=True):
            env.step_async(part)

    def step_wait(
        self,
    ) -> tuple[
        npt.NDArray[np.float32],
        npt.NDArray[np.float32],
        npt.NDArray[np.bool_],
        list[dict[str, Any]],
    ]:
        """Waits for the step and returns its results; slots of rivals are idle."""
        parts = [env.step_wait() for env in self._envs]
        views = np.concatenate([np.asarray(part[0]) for part in parts])
        rewards, dones = (np.concatenate([part[n] for part in parts]) for n in (1, 2))
        infos = [info for part in parts for info in part[3]]
        self._look(views, dones, infos)
        first_infos = [info for env in self._envs for info in env.reset_infos]
        for race in self._races:
            self._update_race(race, dones, rewards, infos)
            if race.ended.all():
                self._report(race)
                self._begin(race, first_infos[race.slots])
        self._observations = self._action_filter.see(views)
        return self._observations, rewards, dones, infos

    def close(self) -> None:
        """Stops the game processes."""
        for env in self._envs:
            env.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Returns an attribute of each slot's race."""
        by_slot = [race.env for race in self._races for _ in range(race.lineup.learners)]
        return [getattr(by_slot[slot], attr_name) for slot in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Not supported, because the curriculum sets the options of the races."""
        raise ConfigError(
            f"{attr_name} of {indices} cannot be set to {value!r}: the curriculum sets it"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Returns the result of a method of each slot's race."""
        methods = self.get_attr(method_name, indices)
        return [method(*method_args, **method_kwargs) for method in methods]

    def env_is_wrapped(self, wrapper_class: Any, indices: Indices = None) -> list[bool]:
        """Returns ``False`` for each slot; none has a Gymnasium wrapper."""
        return [wrapper_class is None for _ in self._get_indices(indices)]

    # ------------------------------------------------------------------ race by race

    def _look(self, views: Any, dones: Any, infos: list[Any]) -> None:
        """Updates the action filter; for ended races, with their last observation."""
        last = np.array(views)
        for slot in np.flatnonzero(dones):
            last[slot] = infos[slot]["terminal_observation"]
        seen = self._action_filter.look(last)
        for slot in np.flatnonzero(dones):
            infos[slot]["terminal_observation"] = seen[slot]

    def _update_race(self, race: _SelfPlayRace, dones: Any, rewards: Any, infos: list[Any]) -> None:
        for row in range(race.lineup.learners):
            slot = race.slots.start + row
            info = infos[slot]
            is_active = not race.ended[row]
            if is_active and dones[slot]:
                race.ended[row], race.finals[row] = True, info
            if race.is_learner[row]:
                self.kart_steps += int(is_active)
                self.rewarded += float(rewards[slot]) * is_active
                if is_active and dones[slot]:
                    infos[slot]["TimeLimit.truncated"] = True
            else:
                infos[slot], rewards[slot], dones[slot] = {}, 0.0, True

    def _report(self, race: _SelfPlayRace) -> None:
        ends = race.ends()
        for end in ends:
            self._curriculum.update(end.pace)
        beaten = [end.beaten for end in ends if end.beaten is not None]
        if beaten:
            pool = self._bots if race.lineup.bots else self._snapshots
            pool.update(race.rival, float(np.mean(beaten)))
        self.ends += ends

    def _begin(self, race: _SelfPlayRace, infos: Sequence[dict[str, Any]]) -> None:
        race.begin(infos)
        self._action_filter.forget(race.slots)
        is_faced = not race.lineup.bots and race.lineup.learners > 1 and self._snapshots.opponents
        if is_faced and self._random.random() < self._snapshot_share:
            race.face(self._snapshots.draw(self._random), self._random)
        self._plan(race)

    def _plan(self, race: _SelfPlayRace) -> None:
        """Draws the options of the next race, which starts automatically."""
        track, reverse = self._curriculum.draw(self._random)
        race.next_from_grid = bool(self._random.random() < self._grid_share)
        known = [bot_name(difficulty) for difficulty in self._curriculum.difficulties]
        bot = self._bots.draw(self._random, known)
        difficulty = int(bot.removeprefix("bot:"))
        limit = PATIENCE * ai_time(track, reverse, difficulty) + COUNTDOWN
        steps = math.ceil(limit / STEP)
        race.env.options = race.env.options.changed(
            {
                "track": track,
                "reverse": reverse,
                "difficulty": difficulty,
                "start": None if race.next_from_grid else RandomStart(),
                "max_cycles": steps if race.next_from_grid else min(steps, SHORT_RACE),
            }
        )
