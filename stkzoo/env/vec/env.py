"""Many races as one Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate

from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.vec.fleet import ParallelRaces
from stkzoo.env.vec.slots import SlotSteps
from stkzoo.errors import ActionError, ConfigError

BoolArray = npt.NDArray[np.bool_]
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
    infos, with a mask ``_<key>``; ``active`` (above) and ``crashed``, whose race the game's
    process has left in this step; ``final_obs`` and ``final_info`` of slots that ended in
    this step, the latter with ``episode``: ``r`` is the return and ``l`` the length.

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
        fleet: the races themselves.

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
        self.fleet = ParallelRaces(num_races, prefetch, {**options, "view": view})
        self.num_races = num_races
        self.num_agents = len(self.fleet.agents)
        self.num_envs = self.fleet.num_slots
        self.single_observation_space = self.fleet.single_observation_space
        self.single_action_space = self.fleet.single_action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @property
    def races(self) -> tuple[RaceParallelEnv, ...]:
        """Every race's environment, to look at; step them through this one alone."""
        return self.fleet.races

    @property
    def prefetch(self) -> bool:
        """Whether the next race of each race is started while it runs."""
        return self.fleet.prefetch

    @property
    def num_crashes(self) -> int:
        """How often the game died or hung, in all races together."""
        return self.fleet.num_crashes

    @property
    def racing(self) -> BoolArray:
        """``(num_envs,)`` bool: whose agent is in its race now, and so will act next."""
        return self.fleet.racing

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
        seeds = seeds_of_races(seed, self.num_races)
        observations, infos = self.fleet.reset(seeds, [options] * self.num_races)
        return self.fleet.batch(observations), {
            **self._columns(infos),
            **self._flag("active", self.racing),
            **self._flag("crashed", np.zeros(self.num_envs, np.bool_)),
        }

    def step(self, actions: Any) -> VectorStep:
        """Advances all races by one step.

        Args:
            actions: one of ``action_space``; those of idle slots are not looked at.

        Returns:
            Observations, rewards ``(num_envs,)`` float64, terminations and truncations
            ``(num_envs,)`` bool, and infos.

        Raises:
            ActionError: an action is invalid; no race has moved.
            ApiOrderError: before ``reset`` or after ``close``.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Asks all races for a step, which they take while the caller goes on."""
        try:
            singles = list(iterate(self.action_space, actions))
        except (TypeError, KeyError, ValueError) as error:
            raise ActionError(
                f"the actions are {actions!r}, expected a batch for {self.num_envs} slots in the "
                f"form of {self.action_space}",
                self.fleet.agents[0],
            ) from error
        self.fleet.step_async(singles)

    def step_wait(self) -> VectorStep:
        """What came of the step that :meth:`step_async` asked for; see :meth:`step`."""
        steps = self.fleet.step_wait()
        return (
            self.fleet.batch(steps.observations),
            steps.rewards,
            steps.terminations,
            steps.truncations,
            self._infos(steps),
        )

    def close_extras(self, **_: Any) -> None:
        """Ends the games; see :meth:`close`."""
        if hasattr(self, "fleet"):
            self.fleet.close()

    def _infos(self, steps: SlotSteps) -> dict[str, Any]:
        infos = self._columns(steps.infos)
        for slot, (observation, info) in steps.finals.items():
            infos = self._add_info(infos, {"final_obs": observation, "final_info": info}, slot)
        return {
            **infos,
            **self._flag("active", steps.active),
            **self._flag("crashed", steps.crashed),
        }

    def _flag(self, name: str, values: BoolArray) -> dict[str, BoolArray]:
        return {name: values, f"_{name}": np.ones(self.num_envs, np.bool_)}

    def _columns(self, infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Infos by slot as arrays by key; like ``_add_info`` slot by slot, but quicker."""
        slots = [slot for slot, info in enumerate(infos) if info]
        present = [infos[slot] for slot in slots]
        keys = list(present[0]) if present else []
        if any(list(info) != keys for info in present):
            return self._added(infos)
        table = np.array([list(info.values()) for info in present])
        if table.ndim != 2 or table.dtype.kind not in "biuf":
            return self._added(infos)
        numbers = np.zeros((len(keys), self.num_envs), table.dtype)
        masks = np.zeros((len(keys), self.num_envs), np.bool_)
        numbers[:, slots], masks[:, slots] = table.T, True
        columns: dict[str, Any] = {}
        for key, value, row, mask in zip(keys, present[0].values(), numbers, masks, strict=True):
            columns[key] = row.astype(np.asarray(value).dtype, copy=False)
            columns[f"_{key}"] = mask
        return columns

    def _added(self, infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        added: dict[str, Any] = {}
        for slot, info in enumerate(infos):
            added = self._add_info(added, dict(info), slot)
        return added


def seeds_of_races(seed: int | Sequence[int | None] | None, num_races: int) -> list[int | None]:
    """Every race's seed, from one for all of them or a list."""
    if seed is None:
        return [None] * num_races
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + number for number in range(num_races)]
    if not isinstance(seed, Sequence) or len(seed) != num_races:
        raise ConfigError(f"seed is {seed!r}, expected a whole number or {num_races}, one a race")
    return list(seed)
