"""Listener that writes a replay of a race."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from stkzoo._os import check_writable
from stkzoo.engine.assets import find_assets
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay.file import (
    DIGEST_SIZE,
    Replay,
    ReplayAgent,
    controls_of,
    next_digest,
    save_replay,
)
from stkzoo.race.result import RaceResult, versions_now

#: Fields of a replay that are copied from the race's description.
_RACE_FACTS = ("track", "reverse", "mode", "laps", "difficulty", "kart_types")


class ReplayWriter(RaceListener):
    """Writes a replay of its race.

    After an interrupt or an error, the file contains the race so far and is marked as partial.

    Args:
        path: path of the file. An existing file is replaced when the race has ended.

    Raises:
        ConfigError: the file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = check_writable(path, "the replay")
        self._head: Replay | None = None
        self._first_digest = b""
        self._steps: list[tuple[list[list[float]], bytes]] = []  # controls and digest per step

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._first_digest, self._steps = next_digest(b"", race.snapshot), []
        self._head = _head(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        still = [0.0] * len(CONTROLS)
        actions, agents = race.actions, race.env.possible_agents
        rows = [controls_of(actions[a]) if a in actions else still for a in agents]
        before = self._steps[-1][1] if self._steps else self._first_digest
        self._steps.append((rows, next_digest(before, race.snapshot)))

    def closed(self) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.ended(None)

    def ended(self, result: RaceResult | None) -> None:
        """Writes the file if a race has started and the file is not yet written."""
        head, self._head = self._head, None
        if head is None:
            return
        controls, digests = zip(*self._steps, strict=True) if self._steps else ((), ())
        links = np.frombuffer(b"".join([self._first_digest, *digests]), np.uint8)
        replay = replace(
            head,
            controls=np.array(controls, np.float32).reshape(-1, *head.controls.shape[1:]),
            digests=links.reshape(-1, DIGEST_SIZE),
            status=result.status if result else head.status,
            result=result,
        )
        save_replay(replay, self.path)


def _head(race: RaceProgress) -> Replay:
    """Returns the replay of a race on the grid, without steps."""
    env, info = race.env, race.race_info
    return Replay(
        **{name: getattr(info, name) for name in _RACE_FACTS},
        kart=env.specs[0].kart or None,
        max_paths=env.options.max_paths,
        step_size=float(env.options.step_size),
        seed=race.seed,
        num_tracks=len(env.options.tracks(find_assets().tracks)),
        engine_seed=info.seed,
        start_positions=tuple(kart + 1 for kart in info.kart_indices),
        agents=tuple(
            ReplayAgent(race.names[agent], race.sources[agent], spec.use_ai)
            for agent, spec in zip(env.possible_agents, env.specs, strict=True)
        ),
        controls=np.empty((0, len(env.possible_agents), len(CONTROLS)), np.float32),
        digests=np.empty((0, DIGEST_SIZE), np.uint8),
        status="partial",
        result=None,
        versions=versions_now(),
    )
