"""Two-stage search: drives candidates in copies of the race and follows the best one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo import Phase, RaceParallelEnv
from stkzoo._checks import check_whole
from stkzoo.agents import heuristic, pretrained
from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.planning.plans import MANEUVERS
from stkzoo.agents.pretrained.driver import read_numbers, read_policy
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.errors import ConfigError

from .copies import Candidate, Choose, RaceCopy, changed, drive_copies

_PRETRAINED = "pretrained:"
#: Number by which a candidate changes the index of the offset.
_SHIFTS = (-3, -2, -1, 1, 2, 3)


@dataclass(frozen=True, slots=True)
class PlannerSettings:
    """Settings of the search.

    Attributes:
        num_candidates: number of candidates for each decision. The first one is the base policy
            without changes, the second one continues the current candidate.
        horizon: number of steps for which all candidates are driven.
        num_finalists: number of the best candidates that are driven further.
        final_steps: number of steps for which they are driven further, by the base policy.
        commitment: number of steps until the next decision.
        holds: numbers of steps for which a candidate may hold.
        maneuver_chance: probability that a candidate has a maneuver of its own.
        nitro_chance: probability that a candidate changes the use of nitro.
        speed_weight: worth of a speed of 1 m/s at the end [m].
        energy_weight: worth of nitro for 1 s at the end [m].
        finish_speed: assumed speed after the finish, and while using nitro before it [m/s].
        rescue_cost: cost of a rescue [m].
    """

    num_candidates: int = 12
    horizon: int = 10
    num_finalists: int = 6
    final_steps: int = 20
    commitment: int = 4
    holds: tuple[int, ...] = (3, 6, 9)
    maneuver_chance: float = 0.3
    nitro_chance: float = 0.2
    speed_weight: float = 0.8
    energy_weight: float = 6.0
    finish_speed: float = 30.0
    rescue_cost: float = 40.0

    def __post_init__(self) -> None:
        check_whole("commitment", self.commitment, 1)
        check_whole("horizon", self.horizon, self.commitment)
        check_whole("num_candidates", self.num_candidates, 1)
        check_whole("num_finalists", self.num_finalists, 1, self.num_candidates)
        check_whole("final_steps", self.final_steps, 0)
        if not self.holds:
            raise ConfigError("holds is empty, expected numbers of steps, such as (3, 6, 9)")


def base_policy(name: str | Path) -> tuple[PlanDriver, Choose | None]:
    """Returns the initial state of a driver and its policy over plans.

    Args:
        name: ``"heuristic"``, ``"pretrained:NAME"``, or the folder of a learned driver.

    Raises:
        ConfigError: there is no such driver, or it does not choose among plans.
    """
    if name == heuristic.player_name:
        return heuristic.create_state(), None
    shipped = str(name).removeprefix(_PRETRAINED)
    folder = Path(name) if shipped == str(name) else Path(pretrained.__path__[0]) / shipped
    policy = read_policy(folder)
    if isinstance(policy, MlpDriver):
        raise ConfigError(f"driver {str(name)!r} does not choose among plans; use another driver")
    return PlanDriver(1, read_numbers(folder)), policy.best


class Planner:
    """Drives the only agent of an environment by searching in copies of its race.

    It keeps its current candidate, so use a new planner for every race.

    Args:
        settings: settings of the search.
        base: driver whose choices the search changes; see :func:`base_policy`.
        seed: seed of its random candidates; the same seed drives the same race.
    """

    def __init__(
        self,
        settings: PlannerSettings | None = None,
        base: str | Path = "pretrained:ace",
        seed: int = 0,
    ) -> None:
        self.settings = settings or PlannerSettings()
        self._driver, self._choose = base_policy(base)
        self._random = np.random.default_rng(seed)
        self._candidate, self._step = Candidate(), 0
        self._copies: list[RaceCopy] = []

    def act(self, env: RaceParallelEnv, observation: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the agent's action; the environment does not advance.

        Args:
            env: an environment in which one agent is not driven by the game's AI, and has the
                ``full`` view.
            observation: current observation of the agent.

        Raises:
            ConfigError: the environment has several such agents, or another view.
            EngineError: the environment does not support copies of its race.
        """
        agent = only_agent(env)
        if (
            not isinstance(observation, Mapping)
            or not {"phase", "paths_start"} <= observation.keys()
        ):
            raise ConfigError(
                f"the planner got an observation of another view than 'full' of agent {agent!r}; "
                "make the environment with view='full'"
            )
        if observation["phase"] < Phase.GO_PHASE:
            return self._driver.drive(observation, self._choose)
        if self._step % self.settings.commitment == 0:
            self._candidate = self._best_candidate(env, agent, observation)
            self._step = 0
        policy = changed(self._choose, [self._candidate], self._step)
        self._step += 1
        return self._driver.drive(observation, policy)

    def close(self) -> None:
        """Ends the processes of the copies; the next decision starts new ones."""
        for race in self._copies:
            race.close()
        self._copies = []

    def _best_candidate(
        self, env: RaceParallelEnv, agent: str, observation: Mapping[str, Any]
    ) -> Candidate:
        settings, candidates = self.settings, self._draw()
        while len(self._copies) < len(candidates):
            self._copies.append(RaceCopy(env.clone(), agent))
        for race, candidate in zip(self._copies, candidates, strict=True):
            race.begin(env, self._driver, observation, candidate)
        drive_copies(self._copies, self._choose, settings.horizon)
        finalists = self._ranked(self._copies)[: settings.num_finalists]
        if len(finalists) > 1:
            drive_copies(finalists, self._choose, settings.final_steps)
        return self._ranked(finalists)[0].candidate

    def _draw(self) -> list[Candidate]:
        candidates = [Candidate(), self._candidate.rest(self._step)]
        while len(candidates) < self.settings.num_candidates:
            candidates.append(self._draw_candidate())
        return candidates[: self.settings.num_candidates]

    def _draw_candidate(self) -> Candidate:
        settings, random = self.settings, self._random
        shift, steps = int(random.choice(_SHIFTS)), int(random.choice(settings.holds))
        maneuver = int(random.integers(MANEUVERS))
        chances = settings.maneuver_chance, settings.nitro_chance
        is_other, flips_nitro = random.random(2) < chances
        return Candidate(shift, steps, maneuver if is_other else None, bool(flips_nitro))

    def _ranked(self, copies: Sequence[RaceCopy]) -> list[RaceCopy]:
        """Returns the copies in the order of their worth, best first."""
        seconds = STEP * max(race.steps for race in copies)
        return sorted(copies, key=lambda race: self._worth(race, seconds), reverse=True)

    def _worth(self, race: RaceCopy, seconds: float) -> float:
        """Returns the distance that a copy reaches [m], with bonuses for its speed and nitro.

        After the finish, the kart is assumed to continue at a constant speed. Nitro counts only as
        far as it can be used before the finish.
        """
        settings = self.settings
        if race.seconds_to_finish is not None:
            left = seconds - race.seconds_to_finish
            return race.length + settings.finish_speed * (left + settings.speed_weight)
        speed = float(race.observation["velocity"][2])
        energy = float(race.observation["energy"][0])  # nitro left [s]
        usable = min(energy, max(race.length - race.distance, 0.0) / settings.finish_speed)
        bonus = settings.speed_weight * speed + settings.energy_weight * usable
        return race.distance + bonus - settings.rescue_cost * race.num_rescues


def only_agent(env: RaceParallelEnv) -> str:
    """Returns the id of the only agent that the game's AI does not drive.

    Raises:
        ConfigError: there are several such agents, or none.
    """
    agents = [
        agent for agent, spec in zip(env.possible_agents, env.specs, strict=True) if not spec.use_ai
    ]
    if len(agents) != 1:
        raise ConfigError(
            f"the planner plans for {len(agents)} agents, expected one agent and, if any, the "
            "game's AI: agents=1, stkzoo demos --karts 1, or stkzoo benchmark --forms P PAAAA"
        )
    return agents[0]
