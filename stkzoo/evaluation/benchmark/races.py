"""The races of the benchmark: drivers, track, start positions and seed."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass

from stkzoo.errors import ConfigError

#: The race forms of the protocol.
FORMS = ("PAAAA", "PPAAA", "P")
_FORM = re.compile(r"(P+)(A*)")
_MAX_KARTS = 20
_SEED_BYTES = 4
#: Ends of the grid.
FRONT, BACK = "front", "back"


@dataclass(frozen=True, slots=True)
class BenchmarkForm:
    """How many karts the agent and the game's AI drive in a race.

    Attributes:
        name: ``"PPAAA"`` is two karts of the agent and three of the AI.
        agents: karts of the agent.
        rivals: karts of the AI.
    """

    name: str
    agents: int
    rivals: int

    @classmethod
    def of(cls, name: str) -> BenchmarkForm:
        """The form with a name.

        Raises:
            ConfigError: the name is not one or more P followed by any number of A.
        """
        found = _FORM.fullmatch(name) if isinstance(name, str) else None
        if found is None or len(name) > _MAX_KARTS:
            raise ConfigError(
                f"race form {name!r} is unknown; expected P for each kart of the agent, then A for "
                f"each of the game's AI, such as PAAAA, at most {_MAX_KARTS} together"
            )
        return cls(name, len(found[1]), len(found[2]))

    @property
    def ends(self) -> tuple[str, ...]:
        """The ends of the grid from which the agent starts; one without rivals."""
        return (FRONT, BACK) if self.rivals else (FRONT,)

    @property
    def chance(self) -> float:
        """The share of races that the agent would win if all were equally good."""
        return self.agents / (self.agents + self.rivals)

    def places(self, end: str) -> tuple[int, ...]:
        """The agent's places on the grid, 0 is in front."""
        first = 0 if end == FRONT else self.rivals
        return tuple(range(first, first + self.agents))


@dataclass(frozen=True, slots=True)
class BenchmarkRace:
    """One race of a benchmark.

    Attributes:
        number: counts the races, from 0.
        track: the track's name.
        reverse: driven in reverse direction.
        form: name of the form, such as ``"PPAAA"``.
        end: the end of the grid from which the agent starts: ``"front"`` or ``"back"``.
        index: counts the races that differ only in their seeds, from 0.
        seed: of all random choices in the race; the same for every agent.
    """

    number: int
    track: str
    reverse: bool
    form: str
    end: str
    index: int
    seed: int

    @property
    def lineup(self) -> BenchmarkForm:
        """How many karts the agent and the AI drive."""
        return BenchmarkForm.of(self.form)

    @property
    def kind(self) -> tuple[str, bool, str, str]:
        """What the races have in common that differ only in their seeds."""
        return self.track, self.reverse, self.form, self.end

    @property
    def key(self) -> tuple[str, bool, str, str, int]:
        """The description of the race, equal in all benchmarks."""
        return *self.kind, self.index


def race_seed(track: str, reverse: bool, form: str, end: str, index: int) -> int:
    """The seed of a race: a digest of its description, independent of the agent."""
    text = "/".join((track, direction_name(reverse), form, end, str(index)))
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=_SEED_BYTES).digest(), "big")


def direction_name(reverse: bool) -> str:
    """``"forward"`` or ``"reversed"``."""
    return "reversed" if reverse else "forward"


def make_races(
    tracks: Sequence[str], directions: Sequence[bool], forms: Sequence[BenchmarkForm], seeds: int
) -> tuple[BenchmarkRace, ...]:
    """All races, ordered by seed first, so that an interrupted benchmark is balanced.

    Args:
        tracks: the tracks.
        directions: ``False`` is forward, ``True`` is reversed.
        forms: karts of the agent and the AI.
        seeds: races of each kind.
    """
    kinds = [
        (track, reverse, form.name, end)
        for track, reverse, form in itertools.product(tracks, directions, forms)
        for end in form.ends
    ]
    return tuple(
        BenchmarkRace(number, *kind, index, race_seed(*kind, index))
        for number, (index, kind) in enumerate(itertools.product(range(seeds), kinds))
    )
