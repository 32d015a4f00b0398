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

import math
from collections.abc import Iterable, Mapping, Sequence
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
from stkzoo.mdp import rewards
from stkzoo.sb3 import RaceVecEnv

from ..common.arguments import Lineup
from ..common.matches import ai_time
from ..ppo.opponents import ITSELF, RivalPool, RivalSeats, bot_name, draw_opponent
from .curriculum import Curriculum

Indices = None | int | Iterable[int]

#: Duration of a step and of the countdown before GO [s].
STEP, COUNTDOWN = 0.1, 2.0
#: Time limit of a race, as a multiple of the AI's median time.
PATIENCE = 2.0
#: Number of steps of a race that does not start on the grid.
SHORT_RACE = 250
#: 0.1 per meter driven, and 0.3 per place gained.
REWARD = Reward({"meters": rewards.advance, "places": rewards.overtaking}, {"places": 0.3})


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


@dataclass(slots=True)
class _RunningRace:
    """Facts of a race: where it takes place, and how its next race begins."""

    track: str = ""
    difficulty: int = 0
    ai_speed: float = 1.0
    is_from_grid: bool = True
    next_is_from_grid: bool = True


class _RaceGroup:
    """Races with the same lineup.

    Args:
        lineup: the lineup.
        first: first slot of the races.
        track: any track.
    """

    def __init__(self, lineup: Lineup, first: int, track: str) -> None:
        self.lineup = lineup
        self.envs = RaceVecEnv(
            lineup.races,
            agents=lineup.learners,
            num_kart=lineup.learners + lineup.bots,
            track=track,
            view="racing",
            reward=REWARD,
            prefetch=False,  # the next race depends on the results
        )
        self.slots = slice(first, first + self.envs.num_envs)
        self.seats = RivalSeats(lineup.races, lineup.learners)
        self.races = [_RunningRace() for _ in range(lineup.races)]
        self.begin_at = np.zeros(self.envs.num_envs)
        self.finals: dict[int, Mapping[str, Any]] = {}
        self.options: list[dict[str, Any]] = [{} for _ in self.races]

    def begin(self, race: int) -> None:
        """Takes the facts of a new race."""
        own, info = self.races[race], self.envs.races.races[race]
        facts, track = info.race, info.track_map
        assert facts is not None and track is not None  # noqa: S101, PT018 - after a reset
        median = ai_time(facts.track, facts.reverse, facts.difficulty)
        own.track, own.difficulty = facts.track, facts.difficulty
        own.ai_speed, own.is_from_grid = track.length / median, own.next_is_from_grid
        for slot in self._slots_of(race):
            self.begin_at[slot] = self.envs.reset_infos[slot]["distance"]

    def ends(self, race: int) -> list[RaceEnd]:
        """Returns the results of the learner's karts in a race that is over."""
        own, finals = self.races[race], [self.finals.pop(slot) for slot in self._slots_of(race)]
        rival = bot_name(own.difficulty) if self.lineup.bots else self.seats.names[race]
        beaten = self._beaten_bots(finals) if self.lineup.bots else self.seats.beaten(race)
        ends = []
        for row in np.flatnonzero(self.seats.is_own[race]).tolist():
            info, steps = finals[row], int(finals[row]["episode/length"])
            seconds = max(STEP * steps - COUNTDOWN * own.is_from_grid, STEP)
            begin_at = self.begin_at[self._slots_of(race)[row]]
            pace = max(float(info["distance"]) - begin_at, 0.0) / seconds / own.ai_speed
            finished = float(info["finish_time"]) > 0
            ends.append(RaceEnd(own.track, rival, beaten, min(pace, 2.0), finished, steps))
        return ends

    def _beaten_bots(self, finals: Sequence[Mapping[str, Any]]) -> float:
        places = [int(info["position"]) for info in finals]
        bots = set(range(1, len(places) + self.lineup.bots + 1)) - {*places}
        return float(np.mean([place < bot for place in places for bot in bots]))

    def _slots_of(self, race: int) -> range:
        count = self.lineup.learners
        return range(race * count, (race + 1) * count)


class SelfPlayVecEnv(VecEnv):
    """Self-play races; each race is drawn from the curriculum and the opponent pools.

    Args:
        lineups: lineups of the races.
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
        self._groups: list[_RaceGroup] = []
        first = 0
        for lineup in lineups:
            self._groups.append(_RaceGroup(lineup, first, curriculum.tracks[0]))
            first = self._groups[-1].slots.stop
        self._random = np.random.default_rng()
        self._action_filter = ActionFilter(first, hold)
        self.kart_steps, self.rewarded = 0, 0.0
        self.ends: list[RaceEnd] = []
        self._observations = np.zeros((first, INPUT_SIZE), np.float32)
        space = spaces.Box(-np.inf, np.inf, (INPUT_SIZE,), np.float32)
        super().__init__(first, space, self._groups[0].envs.action_space)

    def add_driver(self, name: str, driver: MlpDriver) -> None:
        """Adds the driver of a snapshot in the pool."""
        self._drivers[name] = driver

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds all random numbers from the next :meth:`reset` on."""
        self._random = np.random.default_rng(seed)
        for group in self._groups:
            group.envs.seed(int(self._random.integers(2**31)))
        return [seed] * self.num_envs

    def reset(self) -> npt.NDArray[np.float32]:
        """Starts new races; returns the observations of all slots."""
        for group in self._groups:
            group.finals.clear()
            for race in range(group.lineup.races):
                self._plan(group, race)
        views = np.concatenate([np.asarray(group.envs.reset()) for group in self._groups])
        for group in self._groups:
            for race in range(group.lineup.races):
                self._begin(group, race)
        self._observations = self._action_filter.see(views)
        self._reset_seeds()
        self._reset_options()
        return self._observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step with the learner's actions for its karts; rivals choose their own."""
        chosen = np.array(actions)
        for group in self._groups:
            for name, rows in group.seats.rows_by_name().items():
                own = rows + group.slots.start
                chosen[own] = self._drivers[name].sample(self._observations[own], self._random)
        done = self._action_filter.apply(chosen)
        for group in self._groups:
            group.envs.step_async(done[group.slots])

    def step_wait(
        self,
    ) -> tuple[
        npt.NDArray[np.float32],
        npt.NDArray[np.float32],
        npt.NDArray[np.bool_],
        list[dict[str, Any]],
    ]:
        """Waits for the step and returns its results; slots of rivals are idle."""
        parts = [group.envs.step_wait() for group in self._groups]
        views = np.concatenate([np.asarray(part[0]) for part in parts])
        rewards, dones = (np.concatenate([part[n] for part in parts]) for n in (1, 2))
        infos = [info for part in parts for info in part[3]]
        self._look(views, dones, infos)
        for group in self._groups:
            self._update(group, rewards, dones, infos)
        self._observations = self._action_filter.see(views)
        return self._observations, rewards, dones, infos

    def close(self) -> None:
        """Stops the game processes."""
        for group in self._groups:
            group.envs.close()

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Returns an attribute of each slot's race."""
        by_slot = [
            race
            for group in self._groups
            for race in group.envs.races.races
            for _ in range(group.lineup.learners)
        ]
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

    def _update(self, group: _RaceGroup, rewards: Any, dones: Any, infos: list[Any]) -> None:
        """Counts the learner's steps and rewards, makes rivals idle, and begins new races."""
        over = []
        for local, is_own in enumerate(group.seats.is_own.reshape(-1).tolist()):
            slot = group.slots.start + local
            is_active, info = local not in group.finals, infos[slot]
            if is_active and dones[slot]:
                group.finals[local] = info
                if group.seats.end(local, int(info["position"])):
                    over.append(local // group.lineup.learners)
            if is_own:
                self.kart_steps += int(is_active)
                self.rewarded += float(rewards[slot]) * is_active
                if is_active and dones[slot]:
                    info["TimeLimit.truncated"] = True
            else:
                infos[slot], rewards[slot], dones[slot] = {}, 0.0, True
        for race in over:
            self._report(group, group.ends(race))
            self._begin(group, race)

    def _report(self, group: _RaceGroup, ends: Sequence[RaceEnd]) -> None:
        for end in ends:
            self._curriculum.update(end.pace)
        if ends[0].beaten is not None:
            pool = self._bots if group.lineup.bots else self._snapshots
            pool.update(ends[0].rival, ends[0].beaten)
        self.ends += ends

    def _begin(self, group: _RaceGroup, race: int) -> None:
        group.begin(race)
        count, first = group.lineup.learners, group.slots.start
        self._action_filter.forget(slice(first + race * count, first + (race + 1) * count))
        rival = ITSELF
        is_faced = group.lineup.has_duels and self._snapshots.opponents
        if is_faced and self._random.random() < self._snapshot_share:
            rival = draw_opponent(self._snapshots.odds(), self._random)
        group.seats.seat(race, rival, self._random)
        self._plan(group, race)

    def _plan(self, group: _RaceGroup, race: int) -> None:
        """Draws the options of the next race, which starts automatically."""
        track, reverse = self._curriculum.draw(self._random)
        is_from_grid = bool(self._random.random() < self._grid_share)
        known = [bot_name(difficulty) for difficulty in self._curriculum.difficulties]
        bot = draw_opponent(self._bots.odds(known), self._random)
        difficulty = int(bot.removeprefix("bot:"))
        limit = PATIENCE * ai_time(track, reverse, difficulty) + COUNTDOWN
        steps = math.ceil(limit / STEP)
        group.options[race] = {
            "track": track,
            "reverse": reverse,
            "difficulty": difficulty,
            "start": None if is_from_grid else RandomStart(),
            "max_cycles": steps if is_from_grid else min(steps, SHORT_RACE),
        }
        group.envs.races.set_options(group.options)
        group.races[race].next_is_from_grid = is_from_grid
