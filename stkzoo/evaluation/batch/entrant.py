"""Who takes part in a batch of races."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.fingerprint import fingerprint
from stkzoo.evaluation.batch.order import NAME_MARK
from stkzoo.race.agents.failures import printable
from stkzoo.race.drivers import driver_names, find_driver
from stkzoo.race.settings import RaceSettings

__all__ = ["Entrant", "find_entrants"]


@dataclass(frozen=True, slots=True)
class Entrant:
    """An agent that takes part.

    Attributes:
        label: what it is called; nobody else is.
        source: its name or where its files are, for :func:`~stkzoo.race.find_driver`.
        files: a digest of each of its files, by path.
    """

    label: str
    source: str
    files: Mapping[str, str] = field(default_factory=dict, hash=False)

    @classmethod
    def of(cls, label: str, source: str) -> Entrant:
        """An agent with its files as they are now."""
        return cls(label, source, fingerprint(source))

    @property
    def text(self) -> str:
        """The driver's text for a race."""
        return f"{self.source}{NAME_MARK}{self.label}"

    def as_of_now(self) -> Entrant:
        """The agent with its files as they are now."""
        return Entrant.of(self.label, self.source)

    def changed_files(self, now: Entrant) -> list[str]:
        """Those of its files that are others now; new ones do not count."""
        if self.text != now.text:
            return []
        return [name for name, digest in self.files.items() if now.files.get(name) != digest]


def find_entrants(agents: Sequence[str], settings: RaceSettings) -> tuple[Entrant, ...]:
    """The agents that texts name, each under a label of its own.

    Args:
        agents: texts for :func:`~stkzoo.race.find_driver`.
        settings: of the races.

    Raises:
        ConfigError: there is no such agent, or two have one name.
    """
    sources, names = [], []
    for text in agents:
        driver = find_driver(text, inline=settings.inline, adapter=settings.adapter)
        named = text.rpartition(NAME_MARK)[2] if NAME_MARK in text else ""
        sources.append(_lasting(driver.source))
        names.append(printable(named or _short(driver.source)).replace("\n", " "))
    counts = Counter(names)
    labels = [
        name if counts[name] == 1 else (text.rpartition(NAME_MARK)[2] or text)
        for name, text in zip(names, agents, strict=True)
    ]
    for label, count in Counter(labels).items():
        if count > 1:
            raise ConfigError(
                f"{count} agents are called {label!r}; give each a name of its own, such as "
                f"{agents[labels.index(label)].partition(NAME_MARK)[0]}@:{label}-2"
            )
    return tuple(map(Entrant.of, labels, sources))


def _lasting(source: str) -> str:
    """The source such that it is found from everywhere."""
    path = Path(source).expanduser()
    return str(path.resolve()) if source not in driver_names() and path.exists() else source


def _short(source: str) -> str:
    path = PurePath(source)
    return (path.stem if path.suffix in (".zip", ".py") else path.name) or source
