"""Many races as one Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from gymnasium.wrappers.utils import create_zero_array

from stkzoo._checks import check_flag, check_type, check_whole, shortened
from stkzoo._os import cpu_count
from stkzoo.engine.assets import find_assets
from stkzoo.engine.session import CallTurn
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.race import drive_opponents
from stkzoo.env.vec.slots import BoolArray, RaceSlots, SlotSteps, shared_space
from stkzoo.env.vec.starts import RepeatedStarts, seeds_of_races
from stkzoo.errors import ActionError, ApiOrderError, ConfigError
from stkzoo.views.actions import read_action
from stkzoo.views.chains import CheckedActions
from stkzoo.views.plan import form_of

VectorStep = tuple[Any, npt.NDArray[np.float64], BoolArray, BoolArray, dict[str, Any]]


class RaceVectorEnv(VectorEnv[Any, Any, npt.NDArray[Any]]):
    """A Gymnasium vector environment in which every agent of every race is a slot.

    The slot number is ``race * num_agents + agent``. If one policy controls all slots, it plays
    against itself. The races run in parallel, each in its own process.

    **Episode ends.** A slot is terminated once when its agent finishes, or truncated once at the
    time limit. While other agents of its race still drive, the slot is *idle*: its observation is
    all zeros (or the closest values in its space), its reward is 0, its flags are ``False`` and its
    actions are ignored. When the last agent of a race has ended, the race and all its slots restart
    in the same step (``AutoresetMode.SAME_STEP``). ``infos["active"]`` marks the real transitions;
    do not train on the others.

    **Infos** follow Gymnasium's vector format: for each key of the agents' infos, an array over
    slots and a mask ``_<key>``. Further keys are ``active`` (see above); ``crashed``, slots whose
    game crashed in this step; ``track``, each slot's track as an index into :attr:`tracks`; and
    ``final_obs`` and ``final_info`` of the slots that ended in this step. ``final_info`` includes
    ``episode`` with the return ``r`` and the length ``l``.

    **Crashes.** If a game crashes or hangs, its slots are truncated at their last observation with
    reward 0, its race is replaced, and the other races continue. The crash is logged as a warning
    and counted in ``num_crashes``.

    Args:
        num_races: number of races.
        view: see :class:`~stkzoo.env.parallel.RaceParallelEnv`. All agents share it, and its spaces
            must have a fixed size.
        prefetch: whether to start each race's successor while the race runs; ``None`` enables it if
            there are more processor cores than races. It does not change results, and has no effect
            with ``num_starts``.
        num_starts: number of different starts; ``None`` draws a new one for each race. The game
            starts each of them once, and later races copy it, which takes about 4 ms instead of 50
            to 300. A start is everything that ``reset`` draws: track, karts, places and the game's
            random numbers. Each waits in its own process with about 25 MB. Needs Linux.
        start_seed: with ``num_starts``, seed of the set of starts; by default, the seeds of
            ``reset`` determine the set too.
        skip_countdown: with ``num_starts``, whether races begin at GO. All karts wait there at full
            throttle.
        **options: other options of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        num_races: number of races.
        num_agents: number of agents per race.
        num_envs: number of slots, ``num_races * num_agents``.
        races: environments of the races. Use them for inspection only; step the races through this
            object.
        tracks: sorted names of all tracks in the game's data.
        prefetch: whether each race's successor is started while the race runs.
        idle_observation: observation of an idle slot.

    Raises:
        ConfigError: an argument is invalid, or the agents' spaces differ.
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
    autoreset_mode = AutoresetMode.SAME_STEP  # read by TorchRL

    def __init__(
        self,
        num_races: int = 1,
        *,
        view: Any = "flattened_discrete",
        prefetch: bool | None = None,
        num_starts: int | None = None,
        start_seed: int | None = None,
        skip_countdown: bool = False,
        **options: Any,
    ) -> None:
        self._turn = CallTurn()
        check_whole("num_races", num_races, 1)
        if num_starts is not None:
            check_whole("num_starts", num_starts, 1)
        elif start_seed is not None or skip_countdown:
            raise ConfigError(
                "start_seed and skip_countdown need num_starts, such as num_starts=64"
            )
        if prefetch is None:
            prefetch = cpu_count() > num_races
        self.prefetch = check_flag("prefetch", prefetch) and num_starts is None
        if options.get("opponents") is not None:
            from stkzoo.env.opponent_choice import OpponentChoice

            options["opponents"] = OpponentChoice.of(options["opponents"])  # one for all races
        for name, only in (("use_subprocess", True), ("render_mode", None)):
            if options.get(name, only) != only:
                raise ConfigError(
                    f"{name} is {options[name]!r}, but parallel races run in their own "
                    f"processes without a window; leave {name} at {only}, or use a single "
                    "race_v0.parallel_env"
                )
        self.races = tuple(RaceParallelEnv(view=view, **options) for _ in range(num_races))
        first, self.num_races = self.races[0], num_races
        self._repeated = None
        if num_starts is not None:
            new_session = first.live_race.new_session
            self._repeated = RepeatedStarts(num_starts, new_session, start_seed, skip_countdown)
        self.num_agents = len(first.possible_agents)
        self.num_envs = num_races * self.num_agents
        self.single_observation_space = shared_space(first.observation_spaces, "observation")
        self.single_action_space = shared_space(first.action_spaces, "action")
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._form = form_of(self.single_observation_space)
        self.idle_observation = create_zero_array(self.single_observation_space)
        self.tracks = tuple(sorted(find_assets().tracks))
        self._rows = [RaceSlots(race, number) for number, race in enumerate(self.races)]
        self._connect()
        self._names = [f"{a} of race {n}" for n in range(num_races) for a in first.possible_agents]
        self._seeds: list[int | None] = [None] * num_races
        self._is_player = np.array([not spec.use_ai for spec in first.specs] * num_races)

    @property
    def num_crashes(self) -> int:
        """Number of times the game crashed or hung, over all races."""
        return sum(row.num_crashes for row in self._rows)

    @property
    def racing(self) -> BoolArray:
        """``(num_envs,)`` bool, slots whose agent is still racing and acts next."""
        racing = np.zeros(self.num_envs, np.bool_)
        racing[np.concatenate([row.racing_slots for row in self._rows])] = True
        return racing

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random generator of each race."""
        return tuple(race.np_random for race in self.races)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each race's random generator; -1 if no :meth:`reset` has seeded it."""
        return tuple(-1 if seed is None else seed for seed in self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Starts a new race in every environment.

        Args:
            seed: an integer seeds race ``n`` with ``seed + n``. A list has one seed per race.
                ``None``, for all races or in the list, keeps the state of the random generator.
                With ``num_starts``, the seeds determine the order of the starts, and without
                ``start_seed`` also their set.
            options: see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`. They hold for the first
                episode of every race only; see :meth:`set_options`.

        Returns:
            Observations of all slots, and infos.

        Raises:
            ConfigError: a seed or an option is invalid.
            EngineError: the game crashed several times in a row.
        """
        expected = "a dict from names of options to values"
        check_type("options", options, Mapping | None, expected)
        steps = self.reset_slots(seed, [options] * self.num_races)
        return steps.observations, self._infos(steps)

    def reset_slots(
        self,
        seed: int | Sequence[int | None] | None,
        options: Sequence[Mapping[str, Any] | None],
    ) -> SlotSteps:
        """Does the same as :meth:`reset` and returns the results by slot.

        Args:
            seed: see :meth:`reset`.
            options: options of each race for this episode only.

        Raises:
            ApiOrderError: called after ``close``, or while another thread's call runs.
        """
        with self._turn:
            self._require_open("reset")
            seeds = seeds_of_races(seed, self.num_races)
            if self._repeated is not None:
                if any(race_seed is not None for race_seed in seeds):
                    self._repeated.reseed(seeds)
                seeds = [self._next_seed() for _ in seeds]
            for row, race_seed, race_options in zip(self._rows, seeds, options, strict=True):
                row.prepare(race_seed, race_options)
            self._seeds = [
                old if new is None else new for old, new in zip(self._seeds, seeds, strict=True)
            ]
            steps = SlotSteps(self._form, self.num_envs)
            for row, race_seed, race_options in zip(self._rows, seeds, options, strict=True):
                row.reset(steps, race_seed, race_options)
            steps.active |= self.racing
            self._prefetch(self._rows)
            return self._completed(steps)

    def set_options(
        self, options: Mapping[str, Any] | Sequence[Mapping[str, Any] | None] | None
    ) -> None:
        """Changes the options of future races until the next call, for example for a curriculum.

        Running races are unaffected. Options of :meth:`reset` take precedence for one episode.

        Args:
            options: see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`, for example ``{"track":
                "hacienda", "difficulty": 3}``; or a list with options for each race. ``None`` or
                ``{}`` restores the options of the constructor.

        Raises:
            ConfigError: an option is unknown or invalid; nothing has changed.
            ApiOrderError: called after ``close``, or while another thread's call runs; or no agent
                was racing any more at the moment of a state or scenario.
        """
        with self._turn:
            self._require_open("set_options")
            if options is None or isinstance(options, Mapping):
                options = [options] * self.num_races
            if not isinstance(options, Sequence) or len(options) != self.num_races:
                raise ConfigError(
                    f"options is {options!r}, expected a dict or a list of {self.num_races}, "
                    "one per race"
                )
            by_race = [{} if race_options is None else race_options for race_options in options]
            for row, race_options in zip(self._rows, by_race, strict=True):
                row.race.check_options(race_options)
            for row, race_options in zip(self._rows, by_race, strict=True):
                row.options = dict(race_options)
            if any(row.track for row in self._rows):
                self._prefetch(self._rows)

    def step(self, actions: Any) -> VectorStep:
        """Advances all races by one step.

        Args:
            actions: a value of ``action_space``; actions of idle slots are ignored.

        Returns:
            Observations, rewards ``(num_envs,)`` float64, terminations and truncations
                ``(num_envs,)`` bool, and infos.

        Raises:
            ActionError: an action is invalid; no race has advanced.
            ApiOrderError: called before ``reset``, after ``close``, or while another thread's call
                runs.
        """
        with self._turn:
            self.step_async(actions)
            return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Starts a step of all races and returns before it is done.

        Args:
            actions: see :meth:`step`.

        Raises:
            ActionError: an action is invalid; no race has advanced.
            ApiOrderError: called before ``reset``, after ``close``, or twice in a row.
        """
        with self._turn:
            self._require_open("step")
            races = [row.race for row in self._rows]
            checked: Sequence[CheckedActions | None] = [
                row.race.check_rows(actions, row.racing_slots, self.num_envs) for row in self._rows
            ]
            if None in checked:
                checked = self._checked_singly(actions)
            controls = [
                race.convert(acts) for race, acts in zip(races, checked, strict=True) if acts
            ]
            drive_opponents(races, controls)
            for row, players in zip(self._rows, controls, strict=True):
                row.send(players)

    def step_wait(self) -> VectorStep:
        """Waits for the step from :meth:`step_async` and returns its result; see :meth:`step`.

        Raises:
            AgentException: a wrapper failed; ``reset`` starts a new race.
            ApiOrderError: called without :meth:`step_async`.
        """
        steps = self.wait_slots()
        return (
            steps.observations,
            steps.rewards,
            steps.terminations,
            steps.truncations,
            self._infos(steps),
        )

    def wait_slots(self) -> SlotSteps:
        """Does the same as :meth:`step_wait` and returns the results by slot.

        Raises:
            AgentException: a wrapper failed; ``reset`` starts a new race.
            ApiOrderError: called without :meth:`step_async`, or while another thread's call runs.
        """
        with self._turn:
            steps = SlotSteps(self._form, self.num_envs)
            for row in self._rows:
                row.step_wait(steps)
                if row.is_over:  # starts while this call waits for the other races
                    row.prepare()
            over = [row for row in self._rows if row.is_over]
            for row in over:
                row.reset(steps, self._next_seed())
            self._prefetch(over)
            return self._completed(steps)

    def close_extras(self, **_: Any) -> None:
        """Stops the game processes; called by :meth:`close`."""
        with self._turn:
            for row in getattr(self, "_rows", ()):
                row.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._connect()

    def _connect(self) -> None:
        """Lets the races start as copies of starts that wait, if there are any."""
        if self._repeated is not None:
            for race in self.races:
                race.live_race.starts = self._repeated

    def _checked_singly(self, actions: Any) -> list[CheckedActions]:
        """Checks the actions agent by agent, and names the race of an invalid one."""
        singles = self._singles(actions)
        try:
            return [
                row.race.check(dict(zip(row.race.possible_agents, singles[row.slots], strict=True)))
                for row in self._rows
            ]
        except ActionError:
            for slot in np.flatnonzero(self.racing & self._is_player).tolist():
                read_action(self.single_action_space, singles[slot], self._names[slot])
            raise

    def _singles(self, actions: Any) -> list[Any]:
        """Returns one action per slot."""
        try:
            singles = list(iterate(self.action_space, actions))
        except (AttributeError, TypeError, LookupError, ValueError):
            singles = []
        if isinstance(actions, str) or len(singles) != self.num_envs:
            raise ActionError(
                f"the actions are {shortened(actions)}; expected one for each of {self.num_envs} "
                f"slots ({self._names[0]} to {self._names[-1]}), idle ones included",
                self._names[0],
            )
        return singles

    def _next_seed(self) -> int | None:
        """Returns the seed of a race that starts by itself."""
        return None if self._repeated is None else self._repeated.draw_seed()

    def _prefetch(self, rows: Sequence[RaceSlots]) -> None:
        if self.prefetch:
            for row in rows:
                row.prepare()

    def _require_open(self, method: str) -> None:
        if self.closed:
            raise ApiOrderError(f"{method}() after close(); make a new environment")

    def _completed(self, steps: SlotSteps) -> SlotSteps:
        """Adds what concerns all races to the steps of all slots."""
        steps.complete(np.flatnonzero(~self.racing), self.idle_observation)
        for row in self._rows:
            steps.tracks[row.slots] = self.tracks.index(row.track)
        return steps

    def _infos(self, steps: SlotSteps) -> dict[str, Any]:
        infos = steps.infos.columns(self._add_info)
        for slot, (observation, info) in steps.finals.items():
            final = {**info, "track": self.tracks.index(info["track"])}
            infos = self._add_info(infos, {"final_obs": observation, "final_info": final}, slot)
        return {
            **infos,
            **self._flag("active", steps.active),
            **self._flag("crashed", steps.crashed),
            **self._flag("track", steps.tracks),
        }

    def _flag(self, name: str, values: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        return {name: values, f"_{name}": np.ones(self.num_envs, np.bool_)}
