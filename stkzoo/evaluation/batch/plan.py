"""The base class of all plans of batches, and checks of their arguments."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Generic, TypeVar

from msgspec import Meta

from stkzoo.engine.assets import find_assets
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.entrants import Entrant
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.settings import RaceSettings

#: Names of the files of the plan and of the result in a batch's folder.
PLAN_FILE, RESULT_FILE = "plan.json", "result.json"
#: Maximum length of a value, and of the items that differ, in an error [characters].
_MAX_SHOWN, _MAX_ITEMS = 80, 300
#: Maximum number of races of a batch.
MAX_RACES = 100_000
#: Maximum size of the result file of a batch [bytes].
MAX_RESULT_BYTES = 64 << 20
Result = TypeVar("Result")
Plan = TypeVar("Plan", bound="BatchPlan[Any]")


def check_num_races(what: str, count: int) -> None:
    """Checks the number of races of a batch.

    Args:
        what: the batch in the error message, such as ``"benchmark"``.
        count: the number.

    Raises:
        ConfigError: there are too many.
    """
    if count > MAX_RACES:
        raise ConfigError(f"the {what} has {count:,} races, expected at most {MAX_RACES:,}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchPlan(Document, Generic[Result]):
    """The plan of a batch. It determines the races.

    The ``version`` of a plan's file increases when the same plan would lead to different races.

    Attributes:
        tracks: the tracks.
        settings: settings of every race.
        versions: versions of the software.
    """

    origin: ClassVar[str] = f"a {PLAN_FILE} in the --output of one"
    #: Name of this kind of batch, and the command that resumes one in ``{folder}``.
    noun: ClassVar[str]
    resume_command: ClassVar[str]
    #: Fields of :class:`~stkzoo.race.RaceSettings` that the plan itself sets for each race.
    decided: ClassVar[tuple[str, ...]] = ()
    #: Name of the result file, for results that are a :class:`Document`.
    result_file: ClassVar[str] = RESULT_FILE
    #: Whether a part of the races has a result, which :meth:`draw` can plot.
    is_gradual: ClassVar[bool] = True

    tracks: Annotated[tuple[str, ...], Meta(min_length=1, max_length=1000)]
    settings: RaceSettings = field(default_factory=RaceSettings)
    versions: Mapping[str, str] = field(default_factory=versions_now)

    @abstractmethod
    def orders(self) -> Sequence[RaceOrder]:
        """Returns the orders of all races."""

    @abstractmethod
    def summarize(self, results: Mapping[int, RaceResult], folder: Path, /) -> Result:
        """Returns the result of the races that have been run.

        Args:
            results: results of races by number.
            folder: folder of the batch.
        """

    def draw(self, result: Result, path: Path) -> None:
        """Plots the result to a file."""
        raise NotImplementedError

    def report(self, result: Result, results: Mapping[int, RaceResult], folder: Path) -> None:
        """Writes additional files about the result to the batch's folder."""

    def require_libraries(self, plot: bool) -> None:
        """Checks that the libraries for the result and its plot are installed.

        Args:
            plot: whether the result is plotted.

        Raises:
            ConfigError: a library is missing.
        """
        if plot and self.is_gradual:
            require_matplotlib(self.noun, "or leave the plot out (--no-plot)")

    @property
    def agents(self) -> tuple[Entrant, ...]:
        """The agents of the batch."""
        return ()

    def moved(self: Plan, folder: Path) -> Plan:  # noqa: ARG002 - some plans can find their agents
        """Returns the plan with the present places of agents that were moved with its folder.

        Args:
            folder: folder of the batch.
        """
        return self

    def continued(self: Plan, other: Plan) -> Plan:  # noqa: ARG002 - some plans can grow
        """Returns the plan to run in the folder of this plan when another plan is requested.

        Args:
            other: the requested plan.
        """
        return self

    def shown_like(self: Plan, other: Plan) -> Plan:
        """Returns this plan with the ``show_output`` setting of another plan."""
        settings = replace(self.settings, show_output=other.settings.show_output)
        return replace(self, settings=settings)

    def differences(self: Plan, other: Plan) -> list[str]:
        """Describes how another plan of the same kind differs.

        Args:
            other: the other plan.

        Returns:
            One sentence per difference.
        """
        found = describe_differences(self._comparable(), other._comparable())
        for mine, theirs in zip(self.agents, other.agents, strict=False):
            if not (changed := mine.changed_files(theirs)):
                continue
            found.append(
                f"the files of agent {mine.label!r} have changed: {_shown(changed)}"
                if theirs.files
                else f"agent {mine.label!r} is no longer at {mine.source}"
            )
        return found

    def _comparable(self) -> dict[str, Any]:
        """Returns the values that determine the races, by name."""
        values = self.to_dict()
        versions, settings = values.pop("versions"), values.pop("settings")
        for name in ("agent", "entrants"):
            values.pop(name, None)
        ignored = (*self.decided, "show_output")
        values |= {name: value for name, value in settings.items() if name not in ignored}
        software = {"engine": versions.get("pystk2"), "stkzoo": versions.get("stkzoo")}
        return values | software | {"agents": [agent.text for agent in self.agents]}

    @classmethod
    def choose_settings(
        cls, settings: RaceSettings | None, changes: Mapping[str, Any]
    ) -> RaceSettings:
        """Returns the settings of all races of a batch.

        Args:
            settings: settings of the user.
            changes: fields that replace those of ``settings``.

        Raises:
            ConfigError: a change names a field that does not exist or that users cannot set, or a
                value is invalid.
        """
        chosen = RaceSettings.changed(settings, changes, cls.decided)
        if chosen.error_handling == "raise":
            raise ConfigError(
                "error_handling is 'raise', which would end the batch at the first error; choose "
                "retire, catch or restart"
            )
        if chosen.adapter is not None:
            chosen = replace(chosen, adapter=str(Path(chosen.adapter).resolve()))
        return chosen


def describe_differences(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> list[str]:
    """Returns one sentence for each difference between two mappings.

    Args:
        mine: the previous values by name.
        theirs: the new values by name.
    """
    return [
        f"{name} {_difference(mine.get(name), theirs.get(name))}"
        for name in sorted(set(mine) | set(theirs))
        if mine.get(name) != theirs.get(name)
    ]


def _difference(mine: object, theirs: object) -> str:
    """Returns the difference between two values; of long lists, only the items that differ."""
    is_long = max(len(repr(mine)), len(repr(theirs))) > _MAX_SHOWN
    if is_long and isinstance(mine, list) and isinstance(theirs, list):
        return _difference_of_lists(mine, theirs)
    return f"is {_shown(theirs)} and was {_shown(mine)}"


def _difference_of_lists(mine: Sequence[object], theirs: Sequence[object]) -> str:
    more = [item for item in theirs if item not in mine]
    fewer = [item for item in mine if item not in theirs]
    parts = [f"also has {_shown(more, _MAX_ITEMS)}"] * bool(more)
    parts += [f"no longer has {_shown(fewer, _MAX_ITEMS)}"] * bool(fewer)
    return " and ".join(parts) or "has the same items in another order"


def _shown(value: object, limit: int = _MAX_SHOWN) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[:limit] + "..."


def find_tracks(tracks: str | Sequence[str], settings: RaceSettings) -> tuple[str, ...]:
    """Returns the names of tracks, each once, in place of the names of splits.

    Args:
        tracks: names of tracks, or the name of a split (:data:`stkzoo.tracks.SPLITS`).
        settings: settings of the races.

    Raises:
        ConfigError: a track does not exist, or the settings are invalid.
        AssetError: the game's data is missing.
    """
    names = [tracks] if isinstance(tracks, str) else list(tracks)
    if not names:
        raise ConfigError("tracks is empty, expected at least one name")
    known = find_assets().tracks
    shared = ("laps", "difficulty", "reverse", "mode", "max_paths")
    options = {name: getattr(settings, name) for name in shared}
    found: dict[str, None] = {}
    for name in names:
        found.update(dict.fromkeys(RaceOptions(num_kart=2, track=name, **options).tracks(known)))
    return tuple(found)


def check_directions(reverse: Sequence[bool]) -> tuple[bool, ...]:
    """Returns the checked directions of races.

    Args:
        reverse: the directions: ``False`` for forward, ``True`` for reversed.

    Raises:
        ConfigError: there is no direction, or a value is not a direction or occurs twice.
    """
    found = tuple(reverse) if isinstance(reverse, Sequence) else (reverse,)
    if not found or len(set(found)) < len(found) or not set(found) <= {False, True}:
        raise ConfigError(
            f"reverse is {reverse!r}, expected (False, True) or one of both: False is forward"
        )
    return tuple(map(bool, found))
