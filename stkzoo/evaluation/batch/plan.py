"""Plans of batches: the data from which their races follow, and checks of their arguments."""

from __future__ import annotations

import itertools
import os
import shlex
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from msgspec import Meta
from typing_extensions import Self  # a dependency of gymnasium

from stkzoo._checks import shortened
from stkzoo._os import write_text
from stkzoo.engine.assets import find_assets
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.agents import BatchAgent
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.race.document import Document
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

#: Names of the files of the plan and of the result in a batch's folder.
PLAN_FILE, RESULT_FILE = "plan.json", "result.json"
#: Maximum length of a value in an error [characters].
_MAX_SHOWN = 300
#: Maximum number of races of a batch.
MAX_RACES = 100_000
#: Maximum size of the result file of a batch [bytes].
MAX_RESULT_BYTES = 64 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchPlan(Document):
    """The plan of a batch. It determines the races.

    The ``version`` of a plan's file increases when the same plan would lead to different races.

    Attributes:
        agents: the agents.
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
    #: Fields of the plan whose change leaves the stored races valid.
    changeable: ClassVar[tuple[str, ...]] = ()

    agents: tuple[BatchAgent, ...] = ()
    tracks: Annotated[tuple[str, ...], Meta(min_length=1, max_length=1000)]
    settings: RaceSettings = field(default_factory=RaceSettings)
    versions: Mapping[str, str] = field(default_factory=versions_now)

    @property
    def agent(self) -> BatchAgent:
        """The first agent, which is the only one of most batches."""
        return self.agents[0]

    @classmethod
    def settings_of(cls, settings: RaceSettings | None, changes: Mapping[str, Any]) -> RaceSettings:
        """Returns the settings of all races.

        Args:
            settings: settings of the user.
            changes: fields that replace those of ``settings``.

        Raises:
            ConfigError: a change names a field that does not exist or that the plan itself sets, or
                a value is invalid.
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

    @classmethod
    def find(cls, path: str | os.PathLike[str]) -> Self | None:
        """Returns the plan in the folder of a batch; ``None`` for other paths.

        Raises:
            ConfigError: the plan is damaged or of another kind.
        """
        file = Path(path) / PLAN_FILE
        return cls.load(file) if os.path.lexists(file) else None

    @abstractmethod
    def orders(self) -> Sequence[RaceOrder]:
        """Returns the orders of all races."""

    def check_num_races(self, count: int) -> None:
        """Checks the number of races.

        Args:
            count: the number.

        Raises:
            ConfigError: there are too many.
        """
        if count > MAX_RACES:
            raise ConfigError(
                f"the {self.noun} has {count:,} races, expected at most {MAX_RACES:,}"
            )

    def continuing(self, stored: Self) -> Self:  # noqa: ARG002 - some plans add agents
        """Returns the plan as a continuation of the one that is stored in the same folder.

        Args:
            stored: the stored plan.
        """
        return self

    def kept(self, folder: Path) -> Self:
        """Returns the plan to run in a folder, and stores it there.

        It is the plan with the stored digests of the agents' files and the stored versions.

        Args:
            folder: folder of the batch.

        Raises:
            ConfigError: the folder contains a plan for other races.
        """
        stored, kept = self.find(folder), self
        if stored is not None:
            plan = self.continuing(stored)
            if differences := stored.differences(plan):
                command = self.resume_command.format(folder=shlex.quote(str(folder)))
                raise ConfigError(
                    f"{folder} has another {self.noun}: {'; '.join(differences)}. Choose another "
                    f"output, or undo the change and resume: {command}"
                )
            agents = (*stored.agents, *plan.agents[len(stored.agents) :])
            kept = replace(plan, agents=agents, versions=stored.versions)
        if kept != stored:
            write_text(folder / PLAN_FILE, kept.to_json() + "\n")
        return kept

    def differences(self, plan: Self) -> list[str]:
        """Describes how another plan leads to other races than this stored one.

        Args:
            plan: the other plan, with the current files of its agents. It may have more agents.

        Returns:
            One sentence per difference.
        """
        count = len(self.agents)
        differences = describe_differences(self._conditions(count), plan._conditions(count))
        for before, now in zip(self.agents, plan.agents, strict=False):
            changed = before.changed_files(now)
            if changed and now.files:
                files = shortened(changed, _MAX_SHOWN)
                differences.append(f"the files of agent {before.label!r} have changed: {files}")
            elif changed:
                differences.append(f"agent {before.label!r} is no longer at {before.source}")
        return differences

    def _conditions(self, num_agents: int) -> dict[str, Any]:
        """Returns the values that determine the races of the first agents, by name."""
        values = self.to_dict()
        settings, versions = values.pop("settings"), values.pop("versions")
        values["agents"] = [agent.text for agent in self.agents[:num_agents]]
        values |= {"engine": versions.get("pystk2"), "stkzoo": versions.get("stkzoo")}
        names = {*settings, *values} - {*self.changeable, "show_output"}
        return {name: values[name] if name in values else settings[name] for name in names}


def describe_differences(
    before: Mapping[str, Any], now: Mapping[str, Any], prefix: str = ""
) -> list[str]:
    """Returns one sentence for each difference between two mappings, which may contain mappings.

    Args:
        before: the previous values by name.
        now: the new values by name.
        prefix: text before each name.
    """
    differences = []
    for name in sorted(before.keys() | now.keys()):
        old, new = before.get(name), now.get(name)
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            differences += describe_differences(old, new, f"{prefix}{name} ")
        elif old != new:
            after, earlier = shortened(new, _MAX_SHOWN), shortened(old, _MAX_SHOWN)
            differences.append(f"{prefix}{name} is {after} and was {earlier}")
    return differences


# ------------------------------------------------------------------ checks of arguments


def find_tracks(tracks: str | Sequence[str], settings: RaceSettings) -> tuple[str, ...]:
    """Returns the names of tracks, each once, in place of the names of splits.

    Args:
        tracks: names of tracks, or the name of a split (:data:`stkzoo.tracks.SPLITS`).
        settings: settings of the races.

    Raises:
        ConfigError: a track does not exist, or the settings are invalid.
        AssetError: the game's data is missing.
    """
    names = [tracks] if isinstance(tracks, str) else tracks
    if not isinstance(names, Sequence) or not names:
        raise ConfigError(f"tracks is {names!r}, expected at least one name")
    known = find_assets().tracks
    shared = ("laps", "difficulty", "reverse", "mode", "max_paths")
    options = {name: getattr(settings, name) for name in shared}
    named = (RaceOptions(num_kart=2, track=name, **options).tracks(known) for name in names)
    return tuple(dict.fromkeys(itertools.chain(*named)))


def check_directions(reverse: Sequence[bool]) -> tuple[bool, ...]:
    """Returns the checked directions of races.

    Args:
        reverse: the directions: ``False`` for forward, ``True`` for reversed.

    Raises:
        ConfigError: there is no direction, or a value is not a direction or occurs twice.
    """
    directions = tuple(reverse) if isinstance(reverse, Sequence) else (reverse,)
    is_unique = len(set(directions)) == len(directions)
    if not directions or not is_unique or not set(directions) <= {False, True}:
        raise ConfigError(
            f"reverse is {reverse!r}, expected (False, True) or one of both: False is forward"
        )
    return tuple(map(bool, directions))
