"""The part of the parallel core that keeps, restores and copies moments of a race."""

from __future__ import annotations

import contextlib
import copy
import weakref
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from stkzoo.engine.session import Session
from stkzoo.env.episode import Episode
from stkzoo.env.options import RaceOptions
from stkzoo.env.scenario import Scenario, digest_of
from stkzoo.env.state import Moment, RaceState
from stkzoo.errors import ApiOrderError, ConfigError, check_whole
from stkzoo.views.chains import AgentChains

if TYPE_CHECKING:
    from typing_extensions import Self


class BranchingRace:
    """Adds state as a value to :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Args:
        max_snapshots: how many saved states may be open at a time.
    """

    # What RaceParallelEnv brings.
    options: RaceOptions
    possible_agents: list[str]
    agents: list[str]
    _np_random: np.random.Generator | None
    _session: Session
    _chains: AgentChains
    _ai_agents: set[str]
    _episode: Episode | None
    _asked: Episode | None
    _ezpickle_args: tuple[Any, ...]
    _ezpickle_kwargs: dict[str, Any]

    if TYPE_CHECKING:

        @property
        def np_random(self) -> np.random.Generator:
            """The environment's random stream."""

        def close(self) -> None:
            """Ends the game's process."""

        def _running(self, method: str) -> Episode: ...

    def __init__(self, max_snapshots: int) -> None:
        self._max_snapshots = check_whole("max_snapshots", max_snapshots, 0)
        self._states: weakref.WeakSet[RaceState] = weakref.WeakSet()

    def save_state(self) -> RaceState:
        """Keeps this moment of the race; the race itself goes on as if nothing had been.

        Raises:
            ApiOrderError: before the first ``reset``, or with ``max_snapshots`` states open.
            AgentException: an agent's wrapper holds something that cannot be copied.
            EngineError: races are not forked here, or the game died.
        """
        self._running("save_state")
        if self.num_snapshots >= self._max_snapshots:
            raise ApiOrderError(
                f"{self.num_snapshots} saved states of this environment are open, as many as "
                "max_snapshots allows; close() some or raise max_snapshots"
            )
        moment = self._moment()
        state = RaceState(self._session.branch(), moment)
        self._states.add(state)
        return state

    def scenario(self) -> Scenario:
        """This moment as a value that can be saved as a file and reached again elsewhere.

        Raises:
            ApiOrderError: before the first ``reset``, or while a step is under way.
        """
        if self._asked is not None:
            raise ApiOrderError("a step is under way; call step_wait() first")
        episode = self._running("scenario")
        return Scenario(
            setup=episode.setup,
            kart_indices=episode.race.kart_indices,
            agents=tuple(self.agents),
            controls=episode.past_controls(),
            digest=digest_of(episode.snapshot),
        )

    def restore_state(self, state: RaceState) -> None:
        """Goes on from a saved moment, with everything as it was then.

        That includes the counts of the episode, the reward that it was saved with, what
        wrappers remember and the random stream, so that the resets that follow repeat too.
        The race that was running here ends.

        Raises:
            ApiOrderError: the state was closed.
            ConfigError: the state is of an environment with other karts or agents.
            EngineError: races are not forked here, or the state's process was ended; this
                environment's race goes on.
        """
        self._check_moment(_checked_state(state).moment)
        state.resume_in(self._session)
        self._go_on_from(state.moment)

    def clone(self) -> Self:
        """An environment of its own that goes on from this moment.

        Raises:
            ApiOrderError: before the first ``reset``.
            AgentException: an agent's wrapper holds something that cannot be copied.
            EngineError: races are not forked here, or the game died.
        """
        self._running("clone")
        make: Any = type(self)
        twin: Self = make(*self._ezpickle_args, **self._ezpickle_kwargs)
        twin.follow(self)
        return twin

    def follow(self, other: BranchingRace) -> None:
        """Goes on from where another environment is now, like a clone of it.

        Raises: as :meth:`restore_state`.
        """
        other._running("clone")
        moment = other._moment()
        self._check_moment(moment)
        self._session.resume(other._session)
        self.options = other.options
        self._go_on_from(moment)

    @contextlib.contextmanager
    def lookahead(self) -> Iterator[Self]:
        """A clone to try things in, closed at the end; this environment stays where it is.

        Raises: as :meth:`clone`.
        """
        branch = self.clone()
        try:
            yield branch
        finally:
            branch.close()

    @property
    def num_snapshots(self) -> int:
        """How many states that this environment saved are open."""
        return sum(state.is_open for state in self._states)

    def _racing_agents(self, state: object, options: Mapping[str, Any]) -> list[str]:
        """The agents of an episode that starts from a state."""
        moment = _checked_state(state).moment
        moment.check_karts(self.options.num_kart, self.possible_agents, self._ai_agents)
        fixed = set(RaceOptions.__dataclass_fields__) - {"max_cycles", "max_paths", "num_kart"}
        if fixed & set(options):
            raise ConfigError(
                f"options have a state and {', '.join(sorted(fixed & set(options)))}, which the "
                "state's race has already; leave out one or the other"
            )
        if not moment.agents:
            raise ApiOrderError("the state was saved when all agents had left; nobody can act")
        return list(moment.agents)

    def _moment(self) -> Moment:
        if self._asked is not None:
            raise ApiOrderError("a step is under way; call step_wait() first")
        episode = self._running("save_state").copy()
        random = copy.deepcopy(self.np_random)
        memory = self._chains.memory()
        return Moment(episode, tuple(self.agents), frozenset(self._ai_agents), random, memory)

    def _check_moment(self, moment: Moment) -> None:
        moment.check_karts(self.options.num_kart, self.possible_agents, self._ai_agents)
        self._chains.check_memory(moment.memory)

    def _go_on_from(self, moment: Moment) -> None:
        self._asked = None
        self._chains.recall(moment.memory)
        self._episode = moment.episode.copy()
        self.agents = list(moment.agents)
        self._np_random = copy.deepcopy(moment.random)


def _checked_state(state: object) -> RaceState:
    if not isinstance(state, RaceState):
        raise ConfigError(f"state is {state!r}, expected what save_state() returned")
    return state
