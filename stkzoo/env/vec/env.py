"""Many races as one Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate
from gymnasium.wrappers.utils import create_zero_array

from stkzoo._os import cpu_count
from stkzoo._turns import CallTurn
from stkzoo.engine.assets import find_assets
from stkzoo.env.parallel import drive_opponents
from stkzoo.env.vec.ahead import AheadRace
from stkzoo.env.vec.slots import BoolArray, RaceSlots, SlotSteps
from stkzoo.errors import ActionError, ApiOrderError, ConfigError, check_whole
from stkzoo.views.actions import read_action

VectorStep = tuple[Any, npt.NDArray[np.float64], BoolArray, BoolArray, dict[str, Any]]


class RaceVectorEnv(VectorEnv[Any, Any, npt.NDArray[Any]]):
    """Races side by side, in which every agent of every race is a slot.

    Slot ``race * num_agents + agent``; one policy that drives all slots plays against
    itself. The races run in processes of their own, at the same time.

    **Ends.** A slot whose agent finishes is terminated once, or truncated once when time
    is up. While others of its race still drive, it *idles*: its observation is all zeros
    (as near as its space allows), its reward 0, no flag is raised and its actions are not
    looked at. When the last agent of a race has ended, the race starts again in the same
    step (``AutoresetMode.SAME_STEP``), and all its slots with it. ``infos["active"]`` says
    which transitions are real: learn from no others.

    **Infos**, as Gymnasium has them: an array over slots for each key of the agents'
    infos, with a mask ``_<key>``; ``active`` (above); ``crashed``, whose race the game's
    process has left in this step; ``track``, the slot's track as an index into
    :attr:`tracks`; ``final_obs`` and ``final_info`` of slots that ended in this step, the
    latter with ``episode``: ``r`` is the return and ``l`` the length.

    **Crashes.** If the game dies or hangs, its race's slots are truncated with reward 0
    where they were seen last, the race is replaced and the others go on. It is logged as a
    warning and counted by ``num_crashes``.

    Args:
        num_races: how many races.
        view: as for :class:`~stkzoo.env.parallel.RaceParallelEnv`, the same for all agents,
            and of fixed size.
        prefetch: start the next race of each race while it runs; ``None`` does so if there
            are more processor cores than races. It changes no result.
        **options: all others of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        num_races: how many races.
        num_agents: how many agents in each.
        num_envs: how many slots, races times agents.
        races: every race's environment, to look at; step them through this one alone.
        tracks: the names of all tracks of the game's data, sorted.
        prefetch: whether the next race of each race is started while it runs.
        idle_observation: what slots see whose episode has ended before their race.

    Raises:
        ConfigError: an argument is invalid, or agents differ in what they see or do.
        AssetError: the game's data is missing.

    Example:
        >>> import stkzoo
        >>> envs = stkzoo.RaceVectorEnv(2, num_kart=2, track="lighthouse", max_cycles=100)
        >>> observations, infos = envs.reset(seed=1)
        >>> observations["continuous"].shape[0], infos["active"].tolist()
        (4, [True, True, True, True])
        >>> observations, rewards, ends, cuts, infos = envs.step(envs.action_space.sample())
        >>> rewards.shape
        (4,)
        >>> envs.close()
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's convention
        "render_modes": [],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_races: int = 1,
        *,
        view: Any = "flattened_discrete",
        prefetch: bool | None = None,
        **options: Any,
    ) -> None:
        self._turn = CallTurn()
        check_whole("num_races", num_races, 1)
        if not isinstance(prefetch, (bool, type(None))):
            raise ConfigError(f"prefetch is {prefetch!r}, expected True, False or None")
        self.prefetch = cpu_count() > num_races if prefetch is None else prefetch
        if options.get("opponents") is not None:
            from stkzoo.env.opponents import OpponentChoice

            options["opponents"] = OpponentChoice.of(options["opponents"])  # one for all races
        self.races = tuple(AheadRace(view=view, **options) for _ in range(num_races))
        first, self.num_races = self.races[0], num_races
        self.num_agents = len(first.possible_agents)
        self.num_envs = num_races * self.num_agents
        self.single_observation_space = _shared(first.observation_spaces, "observation")
        self.single_action_space = _shared(first.action_spaces, "action")
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.idle_observation = create_zero_array(self.single_observation_space)
        self.tracks = tuple(sorted(find_assets().tracks))
        self._rows = [RaceSlots(race, number) for number, race in enumerate(self.races)]
        self._names = [f"{a} of race {n}" for n in range(num_races) for a in first.possible_agents]
        self._is_player = np.array([not spec.use_ai for spec in first.specs] * num_races)

    @property
    def num_crashes(self) -> int:
        """How often the game died or hung, in all races together."""
        return sum(row.num_crashes for row in self._rows)

    @property
    def racing(self) -> BoolArray:
        """``(num_envs,)`` bool: whose agent is in its race now, and so will act next."""
        return np.concatenate([row.racing for row in self._rows])

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Every race's random stream."""
        return tuple(race.np_random for race in self.races)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Starts new races everywhere.

        Args:
            seed: race number ``n`` is seeded with ``seed + n``; or every race's seed, of
                which ``None`` goes on with the race's random stream, as ``None`` does for
                all.
            options: as for :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`, for the
                first episode of every race alone.

        Returns:
            Observations of all slots and infos.
        """
        if isinstance(options, Mapping) and "reset_mask" in options:
            raise ConfigError(
                "options have a reset_mask, but races start again by themselves, all slots of "
                "a race at once; leave it out"
            )
        steps = self.reset_slots(seed, [options] * self.num_races)
        return self.batch(steps.observations), self._infos(steps)

    def reset_slots(
        self,
        seed: int | Sequence[int | None] | None,
        options: Sequence[Mapping[str, Any] | None],
    ) -> SlotSteps:
        """:meth:`reset` with the results by slot.

        Args:
            seed: as for :meth:`reset`.
            options: each race's options for this episode alone.

        Raises:
            ApiOrderError: after ``close``, or another thread's call runs.
        """
        with self._turn.of("reset"):
            return self._reset_slots(seed, options)

    def _reset_slots(
        self,
        seed: int | Sequence[int | None] | None,
        options: Sequence[Mapping[str, Any] | None],
    ) -> SlotSteps:
        self._require_open("reset")
        seeds = seeds_of_races(seed, self.num_races)
        for row, own_seed, own in zip(self._rows, seeds, options, strict=True):
            row.prepare(own_seed, own)
        steps = SlotSteps.idle(self.idle_observation, self.num_envs)
        for row, own_seed, own in zip(self._rows, seeds, options, strict=True):
            row.reset(steps, own_seed, own)
        steps.active |= self.racing
        self._prefetch(self._rows)
        self._name_tracks(steps)
        return steps

    def set_options(
        self, options: Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None
    ) -> None:
        """Changes every race from its next start on, until the next call; for curricula.

        A race that runs is not changed. Options of :meth:`reset` come first, for one episode.

        Args:
            options: as for :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`, such as
                ``{"track": "hacienda", "difficulty": 3}``; or a list of these, one for each
                race. ``None`` or ``{}`` goes back to the options this was made with.

        Raises:
            ConfigError: an option is unknown or invalid; nothing has changed.
            ApiOrderError: after ``close``, or another thread's call runs.
        """
        with self._turn.of("set_options"):
            self._set_options(options)

    def _set_options(
        self, options: Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None
    ) -> None:
        self._require_open("set_options")
        if options is None or isinstance(options, Mapping):
            options = [options] * self.num_races
        if not isinstance(options, Sequence) or len(options) != self.num_races:
            raise ConfigError(
                f"options is {options!r}, expected a dict or a list of {self.num_races}, one a race"
            )
        by_race = [{} if own is None else own for own in options]
        for row, own in zip(self._rows, by_race, strict=True):
            row.race.check_options(own)
        for row, own in zip(self._rows, by_race, strict=True):
            row.options = dict(own)
        if any(row.track for row in self._rows):
            self._prefetch(self._rows)

    def step(self, actions: Any) -> VectorStep:
        """Advances all races by one step.

        Args:
            actions: one of ``action_space``; those of idle slots are not looked at.

        Returns:
            Observations, rewards ``(num_envs,)`` float64, terminations and truncations
            ``(num_envs,)`` bool, and infos.

        Raises:
            ActionError: an action is invalid; no race has moved.
            ApiOrderError: before ``reset``, after ``close``, or another thread's call runs.
        """
        with self._turn.of("step"):
            self.step_async(actions)
            return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Asks all races for a step, which they take while the caller goes on.

        Raises: as :meth:`step`; also ApiOrderError, if it is called twice in a row.
        """
        with self._turn.of("step_async"):
            self._request_steps(actions)

    def _request_steps(self, actions: Any) -> None:
        try:
            singles = list(iterate(self.action_space, actions))
        except (TypeError, KeyError, ValueError) as error:
            raise ActionError(
                f"the actions are {actions!r}, expected a batch for {self.num_envs} slots in the "
                f"form of {self.action_space}",
                self.races[0].possible_agents[0],
            ) from error
        self._require_open("step")
        if len(singles) != self.num_envs:
            raise ActionError(
                f"{len(singles)} actions came for {self.num_envs} slots ({self.num_races} races "
                f"of {self.num_agents} agents); send one for each, idle ones too",
                self._names[0],
            )
        try:
            controls = [row.decode(singles[row.slots]) for row in self._rows]
        except ActionError:
            self._name_the_race(singles)
            raise
        drive_opponents(self.races, controls)
        for row, own in zip(self._rows, controls, strict=True):
            row.send(own)

    def step_wait(self) -> VectorStep:
        """What came of the step that :meth:`step_async` asked for; see :meth:`step`."""
        steps = self.wait_slots()
        return (
            self.batch(steps.observations),
            steps.rewards,
            steps.terminations,
            steps.truncations,
            self._infos(steps),
        )

    def wait_slots(self) -> SlotSteps:
        """:meth:`step_wait` with the results by slot; races that are over have started again.

        Raises:
            AgentException: a wrapper failed; ``reset`` starts a new race.
            ApiOrderError: no step was asked for, or another thread's call runs.
        """
        with self._turn.of("step_wait"):
            return self._finish_steps()

    def _finish_steps(self) -> SlotSteps:
        steps = SlotSteps.idle(self.idle_observation, self.num_envs)
        for row in self._rows:
            row.step_wait(steps)
            if row.is_over:  # the next one starts while the others are waited for
                row.prepare()
        over = [row for row in self._rows if row.is_over]
        for row in over:
            row.reset(steps)
        self._prefetch(over)
        self._name_tracks(steps)
        return steps

    def batch(self, observations: Sequence[Any]) -> Any:
        """Every slot's observation as one array, or dict of arrays, that nobody else holds."""
        space = self.single_observation_space
        empty: Any = create_empty_array(space, len(observations))
        return concatenate(space, observations, empty)

    def close_extras(self, **_: Any) -> None:
        """Ends the games; see :meth:`close`."""
        with self._turn.of("close"):
            for row in getattr(self, "_rows", ()):
                row.close()

    def _name_the_race(self, actions: Sequence[Any]) -> None:
        """Raises the error of an invalid action with its agent's race in it."""
        for slot in np.flatnonzero(self.racing & self._is_player).tolist():
            read_action(self.single_action_space, actions[slot], self._names[slot])

    def _prefetch(self, rows: Sequence[RaceSlots]) -> None:
        if self.prefetch:
            for row in rows:
                row.prepare()

    def _require_open(self, method: str) -> None:
        if self.closed:
            raise ApiOrderError(f"{method}() after close(); make a new environment")

    def _infos(self, steps: SlotSteps) -> dict[str, Any]:
        infos = self._columns(steps.infos)
        for slot, (observation, info) in steps.finals.items():
            final = {**info, "track": self.tracks.index(info["track"])}
            infos = self._add_info(infos, {"final_obs": observation, "final_info": final}, slot)
        return {
            **infos,
            **self._flag("active", steps.active),
            **self._flag("crashed", steps.crashed),
            **self._flag("track", np.array([self.tracks.index(name) for name in steps.tracks])),
        }

    def _name_tracks(self, steps: SlotSteps) -> None:
        for row in self._rows:
            steps.tracks[row.slots] = [row.track] * self.num_agents

    def _flag(self, name: str, values: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        return {name: values, f"_{name}": np.ones(self.num_envs, np.bool_)}

    def _columns(self, infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Infos by slot as arrays by key; like ``_add_info`` slot by slot, but quicker."""
        slots = [slot for slot, info in enumerate(infos) if info]
        keys = list(infos[slots[0]]) if slots else []
        is_table = all(list(infos[slot]) == keys for slot in slots)
        table = np.array([list(infos[slot].values()) for slot in slots] if is_table else [])
        columns: dict[str, Any] = {}
        if table.ndim != 2 or table.dtype.kind not in "biuf":
            for slot, info in enumerate(infos):
                columns = self._add_info(columns, dict(info), slot)
            return columns
        numbers = np.zeros((len(keys), self.num_envs), table.dtype)
        masks = np.zeros((len(keys), self.num_envs), np.bool_)
        numbers[:, slots], masks[:, slots] = table.T, True
        values = infos[slots[0]].values()
        for key, value, row, mask in zip(keys, values, numbers, masks, strict=True):
            columns[key] = row.astype(np.asarray(value).dtype, copy=False)
            columns[f"_{key}"] = mask
        return columns


def seeds_of_races(seed: int | Sequence[int | None] | None, num_races: int) -> list[int | None]:
    """Every race's seed, from one for all of them or a list."""
    if seed is None:
        return [None] * num_races
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + number for number in range(num_races)]
    if not isinstance(seed, Sequence) or len(seed) != num_races:
        raise ConfigError(f"seed is {seed!r}, expected a whole number or {num_races}, one a race")
    return list(seed)


def _shared(by_agent: Mapping[str, spaces.Space[Any]], kind: str) -> spaces.Space[Any]:
    """The one space of all agents, of a kind that can be one array."""
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {kind} spaces: {dict(by_agent)}; slots of one batch "
            "need one view for all agents, and none or all of them driven by the game's AI"
        )
    if not is_of_fixed_size(first):
        raise ConfigError(
            f"the {kind} space is a {type(first).__name__} whose values differ in size; choose "
            'view="simple", one of the flattened views, or a view of yours with Box, Discrete, '
            "MultiDiscrete, MultiBinary, Text and Dict spaces"
        )
    return first


def is_of_fixed_size(space: spaces.Space[Any]) -> bool:
    """Whether all values of a space have one size, so that many are one array."""
    if isinstance(space, spaces.Dict):
        return all(map(is_of_fixed_size, space.spaces.values()))
    kinds = spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Text
    return isinstance(space, kinds)
