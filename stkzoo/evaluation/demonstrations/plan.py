"""The plan of a data set, checked before the first race."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from stkzoo.errors import ConfigError, StkzooError, check_whole
from stkzoo.evaluation.batch.entrants import Entrant, find_entrants
from stkzoo.evaluation.batch.order import BatchOrder
from stkzoo.evaluation.batch.plan import (
    BatchPlan,
    check_directions,
    choose_settings,
    find_tracks,
)
from stkzoo.evaluation.demonstrations.dataset import (
    Demonstrations,
    load_demonstrations,
    save_demonstrations,
)
from stkzoo.evaluation.demonstrations.recorder import DemoRecorder, DemoView
from stkzoo.race.drivers import find_driver
from stkzoo.race.result import versions_now
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

#: Fields of :class:`~stkzoo.race.RaceSettings` that the plan sets for each race.
DECIDED = ("track", "reverse", "seed", "error_handling", "max_restarts")

#: Default number of reads of the AI's controls per step; the AI decides 12 times.
_SUBSTEPS_OF_AI = 4
_SUBSTEPS = (1, 2, 3, 4, 6, 12)
_MAX_KARTS = 20


@dataclass(frozen=True, slots=True)
class DemoOrder(BatchOrder[Demonstrations]):
    """One race to record.

    Attributes:
        view: the view to record in.
        substeps: see :class:`~stkzoo.evaluation.demonstrations.recorder.DemoRecorder`.
        file: where its episodes are stored.
    """

    view: str = ""
    substeps: int = 1
    file: str = ""

    def run(self) -> str:
        """Runs and records the race, and stores its episodes."""
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
        save_demonstrations(episodes, self.file)
        return result.to_json()

    def load(self, folder: Path) -> Demonstrations | None:  # noqa: ARG002 - it has its own file
        """The stored episodes."""
        return load_demonstrations(self.file) if Path(self.file).exists() else None

    def store(self, folder: Path, text: str) -> Demonstrations:  # noqa: ARG002 - run() has done it
        """The episodes that :meth:`run` has stored."""
        return load_demonstrations(self.file)

    def _settings_in_substeps(self) -> RaceSettings:
        limits = {
            name: getattr(self.settings, name) for name in ("max_steps", "max_steps_after_first")
        }
        scaled = {name: n * self.substeps for name, n in limits.items() if n is not None}
        return replace(self.settings, **scaled)


@dataclass(frozen=True, slots=True)
class DemoPlan(BatchPlan):
    """A whole data set, from which its races follow.

    Attributes:
        agent: the driver to record.
        karts: karts it drives in each race.
        rivals: the other drivers.
        view: the view to record in.
        tracks: the tracks.
        directions: ``False`` is forward, ``True`` is reversed.
        seeds: of the races of each track and direction.
        substeps: parts in which a step is driven; see
            :class:`~stkzoo.evaluation.demonstrations.recorder.DemoRecorder`.
        settings: of every race.
        versions: of the software.
    """

    kind: ClassVar[str] = "demonstrations-plan"
    noun: ClassVar[str] = "data set"
    resume_command: ClassVar[str] = "stkzoo demos AGENT --output {folder}"
    decided: ClassVar[tuple[str, ...]] = DECIDED

    agent: Entrant
    karts: int
    rivals: tuple[str, ...]
    view: str
    tracks: tuple[str, ...]
    directions: tuple[bool, ...]
    seeds: tuple[int, ...]
    substeps: int
    settings: RaceSettings
    versions: Mapping[str, str]

    @property
    def drivers(self) -> list[str]:
        """Texts for :func:`~stkzoo.race.find_driver`, the recorded ones first."""
        return [self.agent.source] * self.karts + list(self.rivals)

    def orders(self) -> list[DemoOrder]:
        """All races, ready to run but for their files."""
        races = itertools.product(self.tracks, self.directions, self.seeds)
        return [
            DemoOrder(
                number,
                tuple(self.drivers),
                replace(self.settings, track=track, reverse=reverse, seed=seed),
                tuple(range(self.karts)),
                self.view,
                self.substeps,
            )
            for number, (track, reverse, seed) in enumerate(races)
        ]

    def _entrants(self) -> tuple[Entrant, ...]:
        return (self.agent,)

    def _comparable(self) -> dict[str, Any]:
        values = BatchPlan._comparable(self)  # super() fails in slotted dataclasses
        return values | {"agent": self.agent.text}


def plan_demonstrations(
    agent: str = "heuristic",
    *,
    view: str = "racing",
    tracks: str | Sequence[str] = "train",
    reverse: Sequence[bool] = (False,),
    seeds: int | Sequence[int] = 1,
    karts: int = 4,
    rivals: Sequence[str] = (),
    substeps: int | None = None,
    settings: RaceSettings | None = None,
    **changes: Any,
) -> DemoPlan:
    """Plans a data set.

    Args:
        agent: the driver to record: ``"ai"`` for the game's AI, a driver's name, a path of a folder
            or zip, a module.
        view: the view to record in, whatever the driver sees itself: a view of fixed size.
        tracks: ``"train"``, ``"test"``, ``"all"``, or names of tracks.
        reverse: the directions: ``False`` is forward, ``True`` is reversed.
        seeds: of the races of each track and direction, or their number, counted from 0.
        karts: karts that it drives in each race; all of them are recorded.
        rivals: the drivers of the other karts, one each.
        substeps: how often the controls of the game's AI are read in a step: 1, 2, 3, 4, 6 or
            12; by default 4 for the AI, and 1 for all others, which decide once.
        settings: of every race; the plan sets the fields in :data:`DECIDED` itself.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that replace those of
            ``settings``.

    Raises:
        ConfigError: an argument is invalid, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    chosen = replace(choose_settings(settings, changes, DECIDED), error_handling="raise")
    check_whole("karts", karts, 1, _MAX_KARTS)
    if isinstance(rivals, str):
        raise ConfigError(f"rivals is {rivals!r}, expected a list of drivers")
    DemoView(view)
    (entrant,) = find_entrants([agent], chosen)
    drivers = [find_driver(text, inline=chosen.inline) for text in (entrant.source, *rivals)]
    return DemoPlan(
        agent=entrant,
        karts=karts,
        rivals=tuple(rivals),
        view=view,
        tracks=find_tracks(tracks, chosen),
        directions=check_directions(reverse),
        seeds=_seeds(seeds),
        substeps=_substeps(substeps, [driver.is_game_ai for driver in drivers]),
        settings=chosen,
        versions=versions_now(),
    )


def _seeds(seeds: int | Sequence[int]) -> tuple[int, ...]:
    if isinstance(seeds, int):
        check_whole("seeds", seeds, 1)
        return tuple(range(seeds))
    found = tuple(seeds)
    for seed in found:
        check_whole("a seed", seed, 0)
    if not found or len(set(found)) < len(found):
        raise ConfigError(f"seeds is {seeds!r}, expected different whole numbers, or how many")
    return found


def _substeps(substeps: int | None, are_game_ai: Sequence[bool]) -> int:
    """Checks the number; agents decide once per step, so theirs is 1."""
    if substeps is None:
        return _SUBSTEPS_OF_AI if all(are_game_ai) else 1
    if substeps not in _SUBSTEPS:
        raise ConfigError(f"substeps is {substeps!r}, expected one of {_SUBSTEPS}")
    if substeps > 1 and not all(are_game_ai):
        raise ConfigError(
            f"substeps is {substeps}, but agents decide once in a step; use 1, or let the game's "
            "AI drive all karts"
        )
    return int(substeps)
