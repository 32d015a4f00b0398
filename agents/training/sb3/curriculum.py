"""A curriculum over tracks and bot difficulties, then reversed tracks."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stkzoo._schema import Count

#: The training tracks, ordered by a simple driver's performance relative to the AI.
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

#: Number of difficulties of the game's bots.
_DIFFICULTIES = 4


class Curriculum:
    """The tracks, directions and difficulties that are open at the current stage.

    Stage ``n`` has the first ``n + 1`` tracks, and one more difficulty every two stages. Once all
    tracks are open, reversed tracks follow. A stage is passed when the mean pace of recent races
    reaches ``pass_at`` times that of the game's AI in such races.

    Args:
        tracks: tracks from easy to hard.
        pass_at: pace that passes a stage, relative to the AI's.
        window: number of karts' races in the mean.
        stage: initial stage.
    """

    def __init__(
        self, tracks: Sequence[str], pass_at: float = 0.75, window: int = 40, stage: int = 0
    ) -> None:
        self.tracks, self.stage = tuple(tracks), stage
        self._pass_at = pass_at
        self._paces: deque[float] = deque(maxlen=window)

    @property
    def open_tracks(self) -> tuple[str, ...]:
        """Tracks of the current stage."""
        return self.tracks[: self.stage + 1]

    @property
    def is_reversible(self) -> bool:
        """Whether the current stage includes reversed tracks."""
        return self.stage >= len(self.tracks)

    @property
    def difficulties(self) -> tuple[int, ...]:
        """Difficulties of the game's bots at the current stage."""
        return tuple(range(min(2 + self.stage // 2, _DIFFICULTIES)))

    def draw(self, random: np.random.Generator) -> tuple[str, bool]:
        """Draws a track and whether it is reversed; the newest track has probability one half."""
        opened = self.open_tracks
        newest = len(self.tracks) > self.stage and random.random() < 0.5
        track = opened[-1] if newest else opened[int(random.integers(len(opened)))]
        return track, self.is_reversible and bool(random.random() < 0.5)

    def update(self, pace: float) -> bool:
        """Adds the pace of a kart in its race; returns whether the next stage begins.

        Args:
            pace: its mean speed over that of the game's AI.
        """
        self._paces.append(pace)
        is_full = len(self._paces) == self._paces.maxlen
        if not is_full or self.stage >= len(self.tracks) or np.mean(self._paces) < self._pass_at:
            return False
        self.stage += 1
        self._paces.clear()
        return True

    def state(self) -> dict[str, Any]:
        """Returns the curriculum's state as JSON values."""
        return {"stage": self.stage, "paces": list(self._paces)}

    def restore(self, state: CurriculumState) -> None:
        """Restores a :meth:`state`.

        Raises:
            msgspec.ValidationError: the state is damaged.
        """
        self.stage = min(state.stage, len(self.tracks))
        self._paces.clear()
        self._paces.extend(state.paces)


@dataclass(frozen=True, slots=True)
class CurriculumState:
    """State of a curriculum, as in its file."""

    stage: Count
    paces: tuple[float, ...]
