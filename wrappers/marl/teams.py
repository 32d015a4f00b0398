"""Teams: shared rewards, and observations of teammates."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo._checks import check_number
from stkzoo.agent_names import find_agent, of_agent
from stkzoo.errors import ConfigError
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.transition import progress_of
from stkzoo.views.walker import StepParts

if TYPE_CHECKING:
    from typing_extensions import Self

#: Observed features of a teammate: position [m] and velocity [m/s] in the observing kart's frame
#: (x right, y up, z forward), its lead over the observing kart along the race [m], rank, nitro,
#: number of its powerup type, and whether it is still racing.
MATE_FEATURES = (
    ("position", 3),
    ("velocity", 3),
    ("ahead", 1),
    ("rank", 1),
    ("energy", 1),
    ("powerup_type", 1),
    ("racing", 1),
)
_SIZE = sum(size for _, size in MATE_FEATURES)


class ClonableWrapper(BaseParallelWrapper[str, Any, Any]):
    """A wrapper of a race that its clones keep, because it has no state between two steps."""

    def clone(self) -> Self:
        """Returns this wrapper around a clone of its environment.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.clone`.
        """
        return copy.deepcopy(self, {id(self.env): self.env.clone()})

    def lookahead(self) -> contextlib.closing[Self]:
        """Yields a clone for trying actions and closes it at the end."""
        return contextlib.closing(self.clone())

    def follow(self, other: Self) -> None:
        """Continues from the current state of another environment with equal wrappers.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.follow`.
        """
        self.env.follow(other.env)


class Teams(ClonableWrapper):
    """Groups the agents of a race into teams.

    An agent's reward becomes ``(1 - share)`` times its own reward plus ``share`` times the mean
    over all members of its team; members that have left count as 0. ``infos[agent]["reward/own"]``
    holds its own reward, ``infos[agent]["reward/team"]`` the mean, and ``infos[agent]["team"]`` the
    number of the team.

    With ``observe``, each observation becomes a dict of ``observation``, the original observation;
    ``team``, the number of the team; and ``mates``, ``(members - 1, 11)`` float32, a row of
    :data:`MATE_FEATURES` for each other member in agent order. The largest team determines the
    number of rows; unused rows are zeros.

    Args:
        env: a race (``race_v0.parallel_env``), perhaps wrapped.
        teams: members of each team, as ids, numbers or numbers as strings. Every agent belongs to
            exactly one team. By default, the teams are those of the agents' specs
            (:class:`~stkzoo.AgentSpec`).
        share: weight of the team's reward, 0 to 1.
        observe: whether agents observe their team.

    Attributes:
        teams: agents of each team.
        team_of: number of each agent's team.

    Raises:
        ConfigError: an argument is invalid.
    """

    def __init__(
        self,
        env: ParallelEnv[str, Any, Any],
        *,
        teams: Sequence[Sequence[Any]] | None = None,
        share: float = 1.0,
        observe: bool = False,
    ) -> None:
        super().__init__(env)
        teams = _teams_of_specs(env) if teams is None else teams
        self.teams = _checked_teams(teams, env.possible_agents)
        self.team_of = {agent: n for n, team in enumerate(self.teams) for agent in team}
        self.share, self.observe = check_number("share", share, 0, 1), bool(observe)
        self._rows = max(map(len, self.teams)) - 1
        self._spaces = {agent: self._space(agent) for agent in env.possible_agents}

    def _space(self, agent: str) -> spaces.Space[Any]:
        space: spaces.Space[Any] = self.env.observation_space(agent)
        if not self.observe:
            return space
        team = spaces.Discrete(len(self.teams))
        mates = spaces.Box(-np.inf, np.inf, (self._rows, _SIZE), np.float32)
        return spaces.Dict({"observation": copy.deepcopy(space), "team": team, "mates": mates})

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space, the same object on every call."""
        return of_agent(self._spaces, agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the race."""
        observations, infos = self.env.reset(seed=seed, options=options)
        racing = frozenset(self.env.agents)
        return self._seen(observations, racing), self._with_team(infos, {}, {})

    def step(self, actions: dict[str, Any]) -> StepParts:
        """Steps the race and shares the rewards."""
        observations, unshared, terminations, truncations, infos = self.env.step(actions)
        means = {
            n: sum(unshared.get(agent, 0.0) for agent in team) / len(team)
            for n, team in enumerate(self.teams)
        }
        rewards = {
            agent: (1 - self.share) * reward + self.share * means[self.team_of[agent]]
            for agent, reward in unshared.items()
        }
        infos = self._with_team(infos, unshared, means)
        # For an agent that is truncated, the race would go on.
        cut = {agent for agent, is_cut in truncations.items() if is_cut}
        observations = self._seen(observations, cut.union(self.env.agents))
        return observations, rewards, terminations, truncations, infos

    def _with_team(
        self, infos: Mapping[str, Any], unshared: Mapping[str, float], means: Mapping[int, float]
    ) -> dict[str, dict[str, Any]]:
        return {
            agent: {
                **info,
                "team": self.team_of[agent],
                "reward/own": unshared.get(agent, 0.0),
                "reward/team": means.get(self.team_of[agent], 0.0),
            }
            for agent, info in infos.items()
        }

    def _seen(self, observations: dict[str, Any], racing: Set[str]) -> dict[str, Any]:
        """Returns the observations with those of the team.

        Args:
            observations: the observations.
            racing: agents that are still racing.
        """
        if not self.observe or not observations:
            return observations
        is_racing = np.array([agent in racing for agent in self.possible_agents])
        known = _known(self.env.unwrapped, is_racing)
        return {
            agent: {
                "observation": observation,
                "team": self.team_of[agent],
                "mates": self._mates(agent, known),
            }
            for agent, observation in observations.items()
        }

    def _mates(self, agent: str, known: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        rows = np.zeros((self._rows, _SIZE), np.float32)
        row_of, team = self.possible_agents.index, self.teams[self.team_of[agent]]
        mates = [row_of(mate) for mate in team if mate != agent]
        rows[: len(mates)] = known[row_of(agent), mates]
        return rows


def _known(race: Any, is_racing: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    """Returns each agent's features in the frame of each observing agent, ``(A, A, 11)``.

    Args:
        race: the race.
        is_racing: ``(A,)`` bool, whether each agent is still racing.
    """
    agents = list(race.race.kart_indices)
    karts, driven = race.snapshot.karts[agents], progress_of(race.snapshot)[agents]
    turns = rotation_matrices(karts["rotation"])
    places, speeds = karts["location"], karts["velocity"]
    features = [karts["position"], karts["energy"], karts["powerup_type"], is_racing]
    parts: list[Any] = [
        to_kart_frame(places[None], places, turns),
        to_kart_frame(speeds[None], np.zeros_like(speeds), turns),
        (driven - driven[:, None])[..., None],
        np.broadcast_to(np.stack(features, axis=-1), (len(agents), len(agents), len(features))),
    ]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def _teams_of_specs(env: ParallelEnv[str, Any, Any]) -> list[list[str]]:
    race: Any = env.unwrapped
    members: dict[int, list[str]] = {}
    for agent, spec in zip(env.possible_agents, race.specs, strict=True):
        if spec.team is not None:
            members.setdefault(spec.team, []).append(agent)
    return [members[number] for number in sorted(members)]


def _checked_teams(
    teams: Sequence[Sequence[Any]], agents: Sequence[str]
) -> tuple[tuple[str, ...], ...]:
    if isinstance(teams, str) or not isinstance(teams, Sequence) or not teams:
        raise ConfigError(
            f"teams is {teams!r}, expected a list of teams, each a list of agents: [[0, 1], [2, 3]]"
        )
    if any(isinstance(team, str) or not isinstance(team, Sequence) or not team for team in teams):
        raise ConfigError(f"a team of {teams!r} is not a list of agents, or is empty")
    members_of = tuple(tuple(find_agent(name, agents) for name in team) for team in teams)
    members = [agent for team in members_of for agent in team]
    for agent in agents:
        if members.count(agent) != 1:
            raise ConfigError(
                f"agent {agent!r} is in {members.count(agent)} teams of {teams!r}, expected one"
            )
    return tuple(tuple(sorted(team, key=list(agents).index)) for team in members_of)
