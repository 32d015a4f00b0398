"""The plan of a dataset, which is checked before the first race, and its recording.

During recording, each race is stored in a folder beside the dataset. When all races are recorded,
they are joined into the dataset, and the folder is removed.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from stkzoo._checks import check_whole
from stkzoo._locks import LOCK
from stkzoo._schema import Count
from stkzoo._temporary import remove_tree
from stkzoo.drivers.driver import find_driver
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.batch.agents import BatchAgent, check_level, find_agents
from stkzoo.evaluation.batch.order import RACES, RaceOrder
from stkzoo.evaluation.batch.plan import PLAN_FILE, BatchPlan, check_directions, find_tracks
from stkzoo.evaluation.batch.run import BatchKind, RaceResults, RunOptions
from stkzoo.evaluation.demonstrations.dataset import (
    Demonstrations,
    join,
    load_demonstrations,
    save_demonstrations,
)
from stkzoo.evaluation.demonstrations.recorder import DemoRecorder, DemoView
from stkzoo.race.result import RaceResult
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

_ENDING, _PARTS = ".safetensors", ".parts"
#: Number of times per step that the AI's controls are read if it drives all karts. It decides 12
#: times per step, and other drivers once.
_SUBSTEPS_OF_AI = 4
_MAX_KARTS = 20


@dataclass(frozen=True, slots=True)
class DemoOrder(RaceOrder):
    """One race to record. Its episodes are stored beside its result.

    Attributes:
        view: name of the view to record in.
        substeps: see :class:`~stkzoo.evaluation.demonstrations.recorder.DemoRecorder`.
    """

    view: str = ""
    substeps: int = 1

    def run(self, folder: Path) -> RaceResult:
        """Runs and records the race, and stores its episodes.

        Args:
            folder: folder of the batch.
        """
        karts = self.wait_for or ()
        recorder = DemoRecorder(len(karts), DemoView(self.view), self.substeps, self.number)
        result = run_race(
            list(self.drivers),
            listeners=[recorder],
            wait_for=karts,
            settings=self._settings_in_substeps(),
        )
        episodes = recorder.episodes({"view": self.view})
        if episodes is None:
            raise StkzooError("the race was over before its first step")
        save_demonstrations(episodes, self.file(folder, _ENDING))
        return result

    def load(self, folder: Path) -> RaceResult | None:
        """Returns the stored result; ``None`` if the race has not been recorded.

        Args:
            folder: folder of the batch.
        """
        return RaceOrder.load(self, folder) if self.file(folder, _ENDING).exists() else None

    def _settings_in_substeps(self) -> RaceSettings:
        limits = {
            name: getattr(self.settings, name) for name in ("max_steps", "max_steps_after_first")
        }
        scaled = {name: n * self.substeps for name, n in limits.items() if n is not None}
        return replace(self.settings, **scaled)


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoPlan(BatchPlan):
    """The plan of a dataset. It determines the races to record.

    Attributes:
        agents: the driver to record.
        karts: number of karts that the driver drives in each race.
        rivals: drivers of the other karts.
        view: name of the view to record in.
        directions: ``False`` for forward, ``True`` for reversed.
        seeds: seeds of the races on each track in each direction.
        substeps: number of parts of a step; see
            :class:`~stkzoo.evaluation.demonstrations.recorder.DemoRecorder`.
    """

    type_name: ClassVar[str] = "demonstrations-plan"
    noun: ClassVar[str] = "dataset"
    #: The folder is beside the command's --output.
    resume_command: ClassVar[str] = "repeat the first command, or delete {folder} to start again"
    decided: ClassVar[tuple[str, ...]] = (
        *("track", "reverse", "seed"),
        *("error_handling", "max_restarts", "show_output"),
    )

    agents: Annotated[tuple[BatchAgent, ...], Meta(min_length=1, max_length=1)]
    karts: Annotated[int, Meta(ge=1, le=_MAX_KARTS)]
    rivals: Annotated[tuple[str, ...], Meta(max_length=255)]
    view: str
    directions: Annotated[tuple[bool, ...], Meta(min_length=1, max_length=2)]
    seeds: Annotated[tuple[Count, ...], Meta(min_length=1)]
    substeps: Annotated[int, Meta(ge=1, le=12)]

    def __post_init__(self) -> None:
        self.check_num_races(len(self.tracks) * len(self.directions) * len(self.seeds))

    def orders(self) -> list[DemoOrder]:
        """Returns the orders of all races."""
        drivers = (self.agent.source,) * self.karts + self.rivals
        races = itertools.product(self.tracks, self.directions, self.seeds)
        return [
            DemoOrder(
                number,
                drivers,
                replace(self.settings, track=track, reverse=reverse, seed=seed),
                tuple(range(self.karts)),
                self.view,
                self.substeps,
            )
            for number, (track, reverse, seed) in enumerate(races)
        ]


def plan_demonstrations(
    agent: str = "heuristic",
    *,
    view: str = "racing",
    tracks: str | Sequence[str] = "train",
    reverse: Sequence[bool] = (False,),
    seeds: int | Sequence[int] = 1,
    karts: int = 4,
    rivals: Sequence[str] = (),
    settings: RaceSettings | None = None,
    **changes: Any,
) -> DemoPlan:
    """Plans a dataset.

    Args:
        agent: the driver to record: ``"ai"`` for the game's AI, the name of a driver, the path of
            a folder or zip, or a module.
        view: name of the view to record in, which must have a fixed size. The driver itself can
            use another view.
        tracks: name of a split (:data:`stkzoo.tracks.SPLITS`), or names of tracks.
        reverse: the directions: ``False`` for forward, ``True`` for reversed.
        seeds: seeds of the races on each track in each direction; or the number of seeds, which
            start at 0.
        karts: number of karts that the driver drives in each race; all of them are recorded.
        rivals: drivers of the other karts, one for each kart.
        settings: settings of every race. The plan itself sets the fields in ``DemoPlan.decided``.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or the agent or a track does not exist.
        AssetError: the game's data is missing.
    """
    chosen = replace(DemoPlan.settings_of(settings, changes), error_handling="raise")
    check_whole("karts", karts, 1, _MAX_KARTS)
    if isinstance(rivals, str):
        raise ConfigError(f"rivals is {rivals!r}, expected a list of drivers")
    DemoView(view)
    (recorded,) = find_agents([agent], chosen)
    drivers = [find_driver(text, inline=chosen.inline) for text in (recorded.source, *rivals)]
    for driver in drivers:
        check_level(driver, chosen)
    return DemoPlan(
        agents=(recorded,),
        karts=karts,
        rivals=tuple(rivals),
        view=view,
        tracks=find_tracks(tracks, chosen),
        directions=check_directions(reverse),
        seeds=_seeds(seeds),
        substeps=_SUBSTEPS_OF_AI if all(driver.is_game_ai for driver in drivers) else 1,
        settings=chosen,
    )


def _seeds(seeds: int | Sequence[int]) -> tuple[int, ...]:
    if isinstance(seeds, int):
        check_whole("seeds", seeds, 1)
        return tuple(range(seeds))
    numbers = tuple(seeds)
    for seed in numbers:
        check_whole("a seed", seed, 0)
    if not numbers or len(set(numbers)) < len(numbers):
        raise ConfigError(f"seeds is {seeds!r}, expected different whole numbers, or how many")
    return numbers


def _join(plan: DemoPlan, _: RaceResults, parts: Path) -> Demonstrations:
    """Returns the recorded episodes of all races."""
    episodes = [load_demonstrations(order.file(parts, _ENDING)) for order in plan.orders()]
    return replace(join(episodes), plan=json.loads(json.dumps(plan.to_dict())))


DEMONSTRATIONS = BatchKind(
    DemoPlan,
    _join,
    lambda demos, _, parts: save_demonstrations(demos, parts.with_suffix("")),
    is_partial=False,
)


def record_demonstrations(
    agent: str = "heuristic", *, output: str | os.PathLike[str], **options: Any
) -> Demonstrations:
    """Records races of a driver as a dataset, or resumes an interrupted recording.

    Args:
        agent: the driver; see :func:`~stkzoo.evaluation.plan_demonstrations`.
        output: file of the dataset, whose name ends in ``.safetensors``. During recording, races
            are stored in a folder beside it, whose name has the additional suffix ``.parts``. The
            same call resumes after an interruption.
        options: ``jobs``, ``race_timeout`` and ``on_race``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_demonstrations`.

    Raises:
        ConfigError: an argument is invalid, or ``output`` contains other demonstrations.
        AssetError: the game's data is missing.
        BatchError: some races could not be recorded.
    """
    run, plan = RunOptions.split(options)
    return run_planned_demonstrations(plan_demonstrations(agent, **plan), output, run)


def run_planned_demonstrations(
    plan: DemoPlan, output: str | os.PathLike[str], options: RunOptions
) -> Demonstrations:
    """Records a planned dataset; see :func:`record_demonstrations`.

    Args:
        plan: the plan.
        output: file of the dataset.
        options: options of the run.
    """
    target = Path(output)
    if target.suffix != _ENDING:
        raise ConfigError(f"the dataset is {str(output)!r}, expected a path that ends in {_ENDING}")
    if target.exists():
        demos = load_demonstrations(target)
        if differences := DemoPlan.from_dict(demos.plan).differences(plan):
            raise ConfigError(
                f"{target} has other demonstrations: {'; '.join(differences)}. Choose another "
                "file, or delete it"
            )
        return demos
    parts = target.with_name(target.name + _PARTS)
    demos = DEMONSTRATIONS.run(plan, parts, options)
    remove_tree(parts / RACES)
    with suppress(OSError):  # the user may have put files there, which stay
        for name in (PLAN_FILE, LOCK):
            (parts / name).unlink(missing_ok=True)
        parts.rmdir()
    return demos
