"""What is to be recorded, checked before the first race."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

from stkzoo.errors import ConfigError, check_whole
from stkzoo.evaluation.batch import BatchKind, Entrant, find_entrants
from stkzoo.evaluation.batch.plans import (
    find_tracks,
    read_form,
    settings_of,
    what_changed,
    write_form,
)
from stkzoo.evaluation.demonstrations.recorder import DemoView
from stkzoo.race.drivers import find_driver
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

__all__ = ["DECIDED", "DEMOS", "DemoOrder", "DemoPlan", "plan_demos"]

#: Fields of :class:`~stkzoo.race.RaceSettings` that the plan decides.
DECIDED = ("track", "reverse", "seed", "error_handling", "max_restarts")

_KIND, _VERSION = "demonstrations-plan", 1
#: How often the AI's controls are read in a step, by default; it decides 12 times.
_SUBSTEPS_OF_AI = 4
_SUBSTEPS = (1, 2, 3, 4, 6, 12)
_MAX_KARTS = 20


@dataclass(frozen=True, slots=True)
class DemoOrder:
    """One race that is to be recorded.

    Attributes:
        number: counts the races, from 0.
        plan: of all races.
        settings: of this one.
        file: where its episodes go.
        worker: the module that runs it.
    """

    number: int
    plan: DemoPlan
    settings: RaceSettings
    file: str = ""
    worker: ClassVar[str] = "stkzoo.evaluation.demonstrations.worker"

    def to_form(self) -> dict[str, Any]:
        """What the process that runs it needs to know."""
        return {
            "number": self.number,
            "plan": self.plan.to_form(),
            "settings": asdict(self.settings),
            "file": self.file,
        }

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> DemoOrder:
        """Reads what :meth:`to_form` gave."""
        plan, settings = DemoPlan.from_form(form["plan"]), RaceSettings(**form["settings"])
        return cls(form["number"], plan, settings, form["file"])


@dataclass(frozen=True, slots=True)
class DemoPlan:
    """A whole data set, from which its races follow.

    Attributes:
        agent: who is recorded.
        karts: how many karts it drives in each race.
        rivals: who else drives.
        view: in which it is recorded.
        tracks: on which tracks.
        directions: ``False`` is forward, ``True`` is reversed.
        seeds: of the races of each track and direction.
        substeps: in how many parts a step is driven; see
            :class:`~stkzoo.evaluation.demonstrations.recorder.DemoRecorder`.
        settings: of every race.
        versions: of the software.
    """

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
        """Texts for :func:`~stkzoo.race.find_driver`, those who are recorded first."""
        return [self.agent.source] * self.karts + list(self.rivals)

    def orders(self) -> list[DemoOrder]:
        """All races."""
        races = itertools.product(self.tracks, self.directions, self.seeds)
        return [
            DemoOrder(number, self, replace(self.settings, track=track, reverse=reverse, seed=seed))
            for number, (track, reverse, seed) in enumerate(races)
        ]

    def to_json(self) -> str:
        """The plan as JSON."""
        return write_form(_KIND, _VERSION, self.to_form())

    def to_form(self) -> dict[str, Any]:
        """The plan as what JSON can hold."""
        return asdict(self)

    @classmethod
    def from_json(cls, text: str) -> DemoPlan:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        return cls.from_form(read_form(text, _KIND, _VERSION))

    @classmethod
    def from_form(cls, form: Mapping[str, Any]) -> DemoPlan:
        """Reads what :meth:`to_form` gave.

        Raises:
            ConfigError: it is something else.
        """
        lists = ("rivals", "tracks", "directions", "seeds")
        try:
            return cls(
                **{
                    **form,
                    **{name: tuple(form[name]) for name in lists},
                    "agent": Entrant(**form["agent"]),
                    "settings": RaceSettings(**form["settings"]),
                }
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ConfigError(
                f"the plan of the demonstrations cannot be read ({type(error).__name__}: {error})"
            ) from error

    def differences(self, other: DemoPlan) -> list[str]:
        """What another plan has otherwise, in words."""
        return what_changed(_flat(self), _flat(other), [(self.agent, other.agent)])


#: Beside which :class:`~stkzoo.evaluation.batch.BatchFolder` the races are kept.
DEMOS = BatchKind("data set", DemoPlan.from_json, "stkzoo demos AGENT --output {folder}")


def _flat(plan: DemoPlan) -> dict[str, Any]:
    form = plan.to_form()
    settings = {k: v for k, v in form.pop("settings").items() if k not in DECIDED}
    versions = {name: plan.versions.get(name) for name in ("stkzoo", "pystk2")}
    return {**form, **settings, **versions, "agent": plan.agent.text, "versions": None}


def plan_demos(
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
        agent: who is recorded: ``"ai"`` for the game's AI, a driver's name, a path of a folder
            or zip, a module.
        view: in which it is recorded, whatever it sees itself: a view of fixed size.
        tracks: ``"train"``, ``"test"``, ``"all"``, or names of tracks.
        reverse: the directions: ``False`` is forward, ``True`` is reversed.
        seeds: of the races of each track and direction, or how many, counted from 0.
        karts: how many karts of each race it drives; all of them are recorded.
        rivals: who drives beside them, one driver each.
        substeps: how often the controls of the game's AI are read in a step: 1, 2, 3, 4, 6 or
            12; by default 4 for the AI, and 1 for all others, which decide once.
        settings: of every race; the track and the seed in it do not count.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that are other than in
            ``settings``.

    Raises:
        ConfigError: an argument cannot be, or there is no such agent or track.
        AssetError: the game's data is missing.
    """
    chosen = replace(settings_of(settings, changes, DECIDED), error_handling="raise")
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
        directions=_directions(reverse),
        seeds=_seeds(seeds),
        substeps=_substeps(substeps, [driver.is_game_ai for driver in drivers]),
        settings=chosen,
        versions=versions_now(),
    )


def _directions(reverse: Sequence[bool]) -> tuple[bool, ...]:
    found = tuple(reverse) if isinstance(reverse, Sequence) else (reverse,)
    if not found or len(set(found)) < len(found) or not set(found) <= {False, True}:
        raise ConfigError(
            f"reverse is {reverse!r}, expected (False, True) or one of both: False is forward"
        )
    return tuple(map(bool, found))


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
    """Checks the number; others than the game's AI decide once in a step, so it is 1 for them."""
    if substeps is None:
        return _SUBSTEPS_OF_AI if all(are_game_ai) else 1
    if substeps not in _SUBSTEPS:
        raise ConfigError(f"substeps is {substeps!r}, expected one of {_SUBSTEPS}")
    if substeps > 1 and not all(are_game_ai):
        raise ConfigError(
            f"substeps is {substeps}, but agents decide once in a step; only where the game's AI "
            "drives all karts can it be above 1"
        )
    return int(substeps)
