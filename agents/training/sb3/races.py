"""Self-play races for Stable-Baselines3: a wrapper of :class:`stkzoo.sb3.RaceVecEnv`.

In some races the learner drives all agents; in the others one of its past selves drives half of
them. A past self's slot is idle: each of its steps is an episode without reward, which
:class:`stkzoo.sb3.ActiveRolloutBuffer` excludes from updates. It can therefore use other slots in
the next race.

The finish counts as a truncation, because the road continues behind the line and a kart does not
observe its distance to the line. If the finish were terminal, the value would drop to zero
unpredictably in the last seconds, by far more than the difference between good and bad driving.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnvWrapper

from stkzoo import RaceState, RandomStart, Reward
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE, ActionFilter
from stkzoo.agents.pretrained.mlp import MlpDriver, load_driver
from stkzoo.mdp import rewards
from stkzoo.sb3 import RaceVecEnv

from ..common.arguments import Lineup
from ..common.matches import ai_time
from ..ppo.opponents import Matchmaker, RivalSeats, draw_opponent
from .curriculum import Curriculum

#: Duration of a step and of the countdown before GO [s].
STEP, COUNTDOWN = 0.1, 2.0
#: Time limit of a race, as a multiple of the AI's median time.
PATIENCE = 2.0
#: Number of steps of a race that does not start on the grid.
SHORT_RACE = 250
#: Number of karts in the means of the log.
_RECENT = 100
#: 0.1 per meter driven, and 0.3 per place gained.
REWARD = Reward(
    {"advance": rewards.advance, "places": rewards.overtaking}, {"places": 0.3}, {"advance": 5.0}
)


@dataclass(frozen=True, slots=True)
class _Start:
    """The start of a race.

    Attributes:
        track: name of the track.
        reverse: whether it is driven in reverse.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        is_from_grid: whether the karts start on the grid, not anywhere on the track.
        state: its moment, to copy.
    """

    track: str
    reverse: bool
    difficulty: int
    is_from_grid: bool
    state: RaceState | None = None

    @property
    def ai_time(self) -> float:
        """The AI's median time in such a race [s]."""
        return ai_time(self.track, self.reverse, self.difficulty)

    @property
    def options(self) -> dict[str, Any]:
        """Options of a race with this start."""
        patience = math.ceil((PATIENCE * self.ai_time + COUNTDOWN) / STEP)
        max_cycles = patience if self.is_from_grid else min(patience, SHORT_RACE)
        if self.state is not None:
            return {"state": self.state, "max_cycles": max_cycles}
        return {
            "track": self.track,
            "reverse": self.reverse,
            "difficulty": self.difficulty,
            "start": None if self.is_from_grid else RandomStart(),
            "max_cycles": max_cycles,
        }


class SelfPlayVecEnv(VecEnvWrapper):
    """Self-play races; each race is drawn from the curriculum and by the matchmaker.

    Args:
        lineup: the races.
        curriculum: determines tracks, directions and difficulties; updated with the results.
        matchmaker: determines the opponents; updated with the results.
        past: folder of the past selves.
        grid_share: fraction of starts on the grid; the others are anywhere on the track.
        num_starts: number of different starts after each :meth:`reset`; later races copy one of
            them, which takes a tenth of the time.
        hold: minimum steps of a drift, for all drivers.

    Attributes:
        kart_steps: number of steps that the learner has driven.
        rewarded: sum of its rewards.
        recent: for each of the learner's latest karts its ``pace`` (mean speed over that of the
            game's AI in such races), whether it ``finished``, and its final ``position``.
    """

    venv: RaceVecEnv

    def __init__(
        self,
        lineup: Lineup,
        curriculum: Curriculum,
        matchmaker: Matchmaker,
        past: Path,
        *,
        grid_share: float = 0.3,
        num_starts: int = 20,
        hold: int = 0,
    ) -> None:
        venv = RaceVecEnv(
            lineup.races,
            agents=lineup.learners,
            num_kart=lineup.learners + lineup.bots,
            track=curriculum.tracks[0],
            view="racing",
            reward=REWARD,
            prefetch=True,  # a core is idle while the learner learns
        )
        super().__init__(venv, spaces.Box(-np.inf, np.inf, (INPUT_SIZE,), np.float32))
        self._curriculum, self._matchmaker, self._past = curriculum, matchmaker, past
        self._grid_share, self._num_starts = grid_share, num_starts
        self._count = venv.races.num_agents
        self._seats = RivalSeats(venv.races.num_races, self._count)
        self._action_filter = ActionFilter(venv.num_envs, hold)
        self._drivers: dict[str, MlpDriver] = {}
        self._random = np.random.default_rng()
        self.kart_steps, self.rewarded = 0, 0.0
        self.recent: deque[dict[str, float]] = deque(maxlen=_RECENT)
        races = venv.races.num_races
        self._starts: list[_Start] = []  # to copy
        self._next: list[_Start] = []  # of the next races
        self._ai_speeds, self._delays = np.ones(races), np.zeros(races)
        self._begin_at = np.zeros(venv.num_envs)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds all random numbers from the next :meth:`reset` on."""
        self._random = np.random.default_rng(seed)
        return self.venv.seed(int(self._random.integers(2**31)))

    def reset(self) -> npt.NDArray[np.float32]:
        """Starts new races; returns the observations of all slots."""
        self._forget_starts()
        races = range(self.venv.races.num_races)
        self._next = [self._draw_start() for _ in races]
        self._set_options()
        views = self.venv.reset()
        for race in races:
            self._begin(race)
        self._observations = self._action_filter.see(views)
        return self._observations

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step with the learner's actions for its karts; rivals choose their own."""
        chosen = np.array(actions)
        for name, rows in self._seats.rows_by_name().items():
            if name not in self._drivers:
                self._drivers[name] = load_driver(self._past / f"{name}.safetensors")
            chosen[rows] = self._drivers[name].sample(self._observations[rows], self._random)
        self._racing = self.venv.races.racing
        self.venv.step_async(self._action_filter.apply(chosen))

    def step_wait(
        self,
    ) -> tuple[
        npt.NDArray[np.float32],
        npt.NDArray[np.float32],
        npt.NDArray[np.bool_],
        list[dict[str, Any]],
    ]:
        """Waits for the step and returns its results; slots of rivals are idle."""
        views, rewards, dones, infos = self.venv.step_wait()
        is_rival = ~self._seats.is_own.reshape(-1)
        learns = self._racing & ~is_rival
        self.kart_steps += int(learns.sum())
        self.rewarded += float(rewards[learns].sum())
        self._look(views, dones, infos)
        for slot in np.flatnonzero(dones & self._racing).tolist():
            infos[slot]["TimeLimit.truncated"] = True
            self._end(slot, infos[slot])
        rewards[is_rival], dones[is_rival] = 0.0, True
        for slot in np.flatnonzero(is_rival).tolist():
            infos[slot] = {}
        self._observations = self._action_filter.see(views)
        return self._observations, rewards, dones, infos

    def close(self) -> None:
        """Ends all races and the starts to copy."""
        self._forget_starts()
        super().close()

    def figures(self) -> dict[str, float]:
        """Returns the means of the latest results; empty without results."""
        names = self.recent[-1] if self.recent else {}
        return {name: float(np.mean([kart[name] for kart in self.recent])) for name in names}

    # ------------------------------------------------------------------ race by race

    def _look(self, views: Any, dones: Any, infos: list[Any]) -> None:
        """Updates the action filter; for ended races, with their last observation."""
        last, ended = np.array(views), np.flatnonzero(dones).tolist()
        for slot in ended:
            last[slot] = infos[slot]["terminal_observation"]
        seen = self._action_filter.look(last)
        for slot in ended:
            infos[slot]["terminal_observation"] = seen[slot]

    def _draw_start(self) -> _Start:
        """Draws the start of a race from those to copy, or a new one if these are too few."""
        if self._starts and len(self._starts) >= self._num_starts:
            return self._starts[int(self._random.integers(len(self._starts)))]
        track, reverse = self._curriculum.draw(self._random)
        difficulty = int(self._random.choice(self._curriculum.difficulties))
        return _Start(track, reverse, difficulty, bool(self._random.random() < self._grid_share))

    def _set_options(self) -> None:
        """Sets the options of the next races, which start automatically."""
        self.venv.races.set_options([start.options for start in self._next])

    def _begin(self, race: int) -> None:
        """Takes the facts of a race that has begun, and draws its drivers and the next start."""
        start, env = self._next[race], self.venv.races.races[race]
        if start.state is None and len(self._starts) < self._num_starts:
            self._starts.append(replace(start, state=env.save_state()))
        assert env.track_map is not None  # noqa: S101 - after a reset
        self._ai_speeds[race] = env.track_map.length / start.ai_time
        self._delays[race] = COUNTDOWN if start.is_from_grid else 0.0
        slots = slice(race * self._count, (race + 1) * self._count)
        self._begin_at[slots] = [info["distance"] for info in self.venv.reset_infos[slots]]
        self._action_filter.forget(slots)
        rival = draw_opponent(self._matchmaker.odds(), self._random)
        self._seats.seat(race, rival, self._random)
        self._next[race] = self._draw_start()
        self._set_options()

    def _forget_starts(self) -> None:
        for start in self._starts:
            if start.state:
                start.state.close()
        self._starts.clear()

    def _end(self, slot: int, info: Mapping[str, Any]) -> None:
        """Records the end of a kart's race, and of the race if it was the last kart."""
        race, agent = divmod(slot, self._count)
        if self._seats.is_own[race, agent]:
            seconds = max(STEP * int(info["episode"]["l"]) - self._delays[race], STEP)
            driven = max(float(info["distance"]) - self._begin_at[slot], 0.0)
            pace = min(driven / seconds / float(self._ai_speeds[race]), 2.0)
            finished, position = float(info["finish_time"] > 0), int(info["position"])
            self.recent.append({"pace": pace, "finished": finished, "position": position})
            self._curriculum.update(pace)
        if self._seats.end(slot, int(info["position"])):
            beaten = self._seats.beaten(race)
            if beaten is not None:
                self._matchmaker.update(self._seats.names[race], beaten)
            self._begin(race)
