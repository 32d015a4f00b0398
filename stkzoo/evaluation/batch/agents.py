"""The agents of a batch, each with a unique label and digests of its files."""

from __future__ import annotations

import hashlib
import itertools
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from stkzoo._os import read_blocks
from stkzoo._schema import distinct_name, plain_name, plain_text
from stkzoo.drivers.driver import Driver, declared_name, driver_names, find_driver
from stkzoo.drivers.files import (
    ACTOR_MODULE,
    MAX_BYTES,
    find_files,
    module_paths,
    name_of_files,
)
from stkzoo.drivers.sandbox import say_what_is_missing
from stkzoo.errors import ConfigError
from stkzoo.race.remote.drivers import ServedAgent
from stkzoo.race.settings import RaceSettings

#: Separator between a driver's source and its name.
NAME_MARK = "@:"
_MOST_FILES = 1000
_MOST_CHARACTERS = 28  # with a number at most 32
_DIGEST_SIZE = 8
#: Folders and files that change when an agent runs, or is committed or looked at.
_IGNORED = ("__pycache__", ".git", ".hg", ".svn", ".DS_Store")
_IGNORED_ENDING = ".log"


@dataclass(frozen=True, slots=True)
class BatchAgent:
    """An agent of a batch.

    Attributes:
        label: name of the agent, unique in the batch.
        source: driver name or path for :func:`~stkzoo.race.find_driver`.
        files: digests of its files by path.
        served: the agent on a server; ``None`` for an agent that runs here.
    """

    label: Annotated[str, Meta(min_length=1)]
    source: Annotated[str, Meta(min_length=1)]
    files: Mapping[str, str] = field(default_factory=dict, hash=False)
    served: ServedAgent | None = None

    @classmethod
    def of(cls, label: str, source: str) -> BatchAgent:
        """Returns an agent with digests of its current files."""
        return cls(label, source, fingerprint(source))

    def now(self) -> BatchAgent:
        """Returns the agent with digests of its current files."""
        return self if self.served else BatchAgent.of(self.label, self.source)

    @property
    def text(self) -> str:
        """The driver's text for a race: source and label."""
        return f"{self.source}{NAME_MARK}{self.label}"

    def changed_files(self, now: BatchAgent) -> list[str]:
        """Returns the paths of files that have changed or are missing now; ignores new files.

        Args:
            now: the agent with its current files. For another agent, the result is empty.
        """
        if self.text != now.text:
            return []
        return [name for name, digest in self.files.items() if now.files.get(name) != digest]


def find_agents(
    agents: Sequence[str],
    settings: RaceSettings,
    served: Sequence[ServedAgent] = (),
    taken: Collection[str] = (),
) -> tuple[BatchAgent, ...]:
    """Finds agents and gives each a unique label.

    The label is the name after ``@:``. Without one, it is the agent's ``player_name``; without
    that, the name of its file. If it looks like another label, a number is appended: ``Ada-2``.

    Args:
        agents: texts for :func:`~stkzoo.race.find_driver`.
        settings: settings of the races.
        served: agents on servers, which come after the others.
        taken: labels of other agents in the batch.

    Raises:
        ConfigError: an agent does not exist or requires another difficulty than the races have,
            two agents were given the same name, or the sandbox is not available.
    """
    labels = [*taken]
    entries = []
    for text in agents:
        driver = find_driver(text, inline=settings.inline, adapter=settings.adapter)
        check_level(driver, settings)
        if driver.is_from_files and not settings.inline:
            say_what_is_missing(settings.sandbox)
        text = str(text)  # it may be a Path
        is_fixed = NAME_MARK in text or driver.is_game_ai
        labels.append(_unique(_name_of(text, driver), labels, is_fixed=is_fixed, text=text))
        entries.append(BatchAgent.of(labels[-1], _lasting(driver.source)))
    for agent in served:
        labels.append(_unique(agent.name or _short(agent.source), labels))
        entries.append(BatchAgent(labels[-1], agent.place, served=agent))
    return tuple(entries)


def is_among(text: str, agents: Sequence[BatchAgent]) -> bool:
    """Returns whether :func:`find_agents` has already found an agent for a text.

    Args:
        text: text for :func:`~stkzoo.race.find_driver`.
        agents: the agents found so far.

    Raises:
        ConfigError: the agent does not exist.
    """
    driver = find_driver(text)
    source, name = _lasting(driver.source), _plain(_name_of(text, driver))
    number = "" if NAME_MARK in text else r"(-\d+)?"
    return any(
        entry.source == source and re.fullmatch(re.escape(name) + number, entry.label)
        for entry in agents
    )


def check_level(driver: Driver, settings: RaceSettings) -> None:
    """Checks that a driver does not change the difficulty of the races of a batch.

    Races with such a driver would have another difficulty than the plan says.

    Args:
        driver: the driver.
        settings: settings of the races.

    Raises:
        ConfigError: the driver requires another difficulty.
    """
    if driver.difficulty not in (None, settings.difficulty):
        raise ConfigError(
            f"{driver.source!r} requires difficulty {driver.difficulty}, but the races have "
            f"difficulty {settings.difficulty}; name ai or ai:{settings.difficulty}, or change the "
            "difficulty of the races"
        )


def _unique(name: str, taken: Collection[str], *, is_fixed: bool = False, text: str = "") -> str:
    """Returns a label that is not used yet.

    Args:
        name: the preferred label.
        taken: labels in use.
        is_fixed: whether the label must not get a number.
        text: the agent's text, for the error.

    Raises:
        ConfigError: the label is fixed and already used.
    """
    name = _plain(name)
    label = distinct_name(name, taken)
    if is_fixed and label != name:
        called = repr(name) if name in taken else f"{name!r} (in different case)"
        raise ConfigError(
            f"two agents are called {called}; give each a different name, such as "
            f"{text.partition(NAME_MARK)[0]}@:{label}"
        )
    return label


def _name_of(text: str, driver: Driver) -> str:
    """Returns the name that a text gives to its agent, or that of the agent's code or files."""
    chosen = text.rpartition(NAME_MARK)[2] if NAME_MARK in text else ""
    return chosen or declared_name(driver.source) or _short(driver.source)


def _plain(name: str) -> str:
    """Returns a name as a label."""
    return plain_name(plain_name(name).replace(NAME_MARK, " "), _MOST_CHARACTERS) or "unnamed"


def _lasting(source: str) -> str:
    """Returns a source that does not depend on the current directory."""
    path = Path(source).expanduser()
    return str(path.resolve()) if source not in driver_names() and path.exists() else source


def _short(source: str) -> str:
    return name_of_files(source) or source


def fingerprint(source: str) -> dict[str, str]:
    """Returns digests of an agent's files, by path.

    Paths begin with the name of the agent's folder or file. A ``pystk_actor.py`` counts with all
    files of its folder, which it can read in its sandbox. Logs, ``__pycache__``, version control
    and all files after the first 1,000 are left out, and all content after the first 512 MiB: a
    link of the agent can name a file without end. Drivers that come with stkzoo have no files;
    stkzoo's version identifies them.

    Args:
        source: text for :func:`~stkzoo.race.find_driver`, without ``@:Name``.
    """
    home = None if source in driver_names() else _home(source)
    if home is None:
        return {}
    top = home.parent if home.name == f"{ACTOR_MODULE}.py" else home
    digests, left = {}, MAX_BYTES
    for file in itertools.islice(_files(top), _MOST_FILES):
        digest, size = _digest(file, left)
        digests[plain_text(file.relative_to(home.parent).as_posix())] = digest
        left -= size
    return digests


def _home(source: str) -> Path | None:
    files = find_files(source)
    if files is None or files.path is not None:
        return files.path if files else None
    return next((Path(path).resolve() for path in module_paths(source)), None)


def _files(home: Path) -> Iterator[Path]:
    if home.is_file():
        yield home
        return
    for folder, folders, names in os.walk(home):
        folders[:] = sorted({*folders} - {*_IGNORED}, key=_hidden_last)
        for name in sorted({*names} - {*_IGNORED}, key=_hidden_last):
            file = Path(folder, name)
            if not name.endswith(_IGNORED_ENDING) and file.is_file():
                yield file


def _hidden_last(name: str) -> tuple[bool, str]:
    return name.startswith("."), name


def _digest(file: Path, most: int) -> tuple[str, int]:
    """Returns the digest of the beginning of a file and its size, which is at most ``most``."""
    digest, size = hashlib.blake2b(digest_size=_DIGEST_SIZE), 0
    try:
        for block in read_blocks(file, most):
            digest.update(block)
            size += len(block)
    except OSError:
        return "unreadable", size
    return digest.hexdigest(), size
