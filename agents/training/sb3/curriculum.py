"""From easy to hard: more tracks, then both directions, then the game's better bots."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from stkzoo._schema import Count, Within, typed

#: The training tracks in the order of how well a simple driver does on them, beside the AI.
EASY_TO_HARD = (
    "lighthouse",
    "cornfield_crossing",
    "gran_paradiso_island",
    "volcano_island",
    "abyss",
    "hacienda",
    "snowmountain",
    "candela_city",
    "ravenbridge_mansion",
    "mines",
    "snowtuxpeak",
    "olivermath",
    "minigolf",
    "stk_enterprise",
    "black_forest",
)

#: Bots of the game's difficulties 0 to 3.
_DIFFICULTIES = 4


class Curriculum:
    """What races may be like by now.

    Stage ``n`` has the first ``n + 1`` tracks and, of the difficulties, one more for each two
    stages; once all tracks are there, the reversed ones too. A stage is passed when the mean pace
    of the races since is at least ``pass_at`` of that of the game's AI in such races.

    Args:
        tracks: from easy to hard.
        pass_at: the pace, as a share of the AI's.
        window: over how many karts' races it is taken.
        stage: to begin with.
    """

    def __init__(
        self, tracks: Sequence[str], pass_at: float = 0.75, window: int = 40, stage: int = 0
    ) -> None:
        self.tracks, self.stage = tuple(tracks), stage
        self._pass_at = pass_at
        self._paces: deque[float] = deque(maxlen=window)

    @property
    def open_tracks(self) -> tuple[str, ...]:
        """Those that may be raced on."""
        return self.tracks[: self.stage + 1]

    @property
    def is_reversible(self) -> bool:
        """Whether tracks are driven the other way round too."""
        return self.stage >= len(self.tracks)

    @property
    def difficulties(self) -> tuple[int, ...]:
        """How hard the game's bots may be."""
        return tuple(range(min(2 + self.stage // 2, _DIFFICULTIES)))

    def draw(self, random: np.random.Generator) -> tuple[str, bool]:
        """A track and whether it is reversed; the newest track comes half of the time."""
        opened = self.open_tracks
        newest = len(self.tracks) > self.stage and random.random() < 0.5
        track = opened[-1] if newest else opened[int(random.integers(len(opened)))]
        return track, self.is_reversible and bool(random.random() < 0.5)

    def update(self, pace: float) -> bool:
        """Updates with the pace of a kart in its race; whether the next stage begins.

        Args:
            pace: its metres a second over those of the game's AI.
        """
        self._paces.append(pace)
        is_full = len(self._paces) == self._paces.maxlen
        if not is_full or self.stage >= len(self.tracks) or np.mean(self._paces) < self._pass_at:
            return False
        self.stage += 1
        self._paces.clear()
        return True

    def state(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {"stage": self.stage, "paces": list(self._paces)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restores a :meth:`state`.

        Raises:
            Unreadable: it is damaged.
        """
        known = typed(_CurriculumState, state)
        self.stage = min(known.stage, len(self.tracks))
        self._paces.clear()
        self._paces.extend(known.paces)


@dataclass(frozen=True, slots=True)
class _CurriculumState:
    """A state of a curriculum, as its file has it."""

    stage: Count
    paces: Annotated[tuple[float, ...], Within(0, 100_000)]
