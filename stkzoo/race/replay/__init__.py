"""Replays: recorded races that the engine reproduces bit for bit.

>>> from stkzoo.race import run_race
>>> from stkzoo.race.replay import ReplayWriter, load_replay, play_replay
>>> listeners = [ReplayWriter("/tmp/race.stkz")]
>>> _ = run_race(["heuristic", "ai"], track="lighthouse", max_steps=20, listeners=listeners)
>>> playback = play_replay(load_replay("/tmp/race.stkz"))
>>> playback.steps, playback.is_exact
(20, True)
"""

from __future__ import annotations

from stkzoo.race.replay.file import (
    Replay,
    ReplayAgent,
    ReplayError,
    ReplayWriter,
    controls_of,
    load_replay,
    save_replay,
)
from stkzoo.race.replay.playback import (
    Playback,
    ghost_of,
    other_versions,
    play_replay,
    recorded_driver,
)

__all__ = [
    "Playback",
    "Replay",
    "ReplayAgent",
    "ReplayError",
    "ReplayWriter",
    "controls_of",
    "ghost_of",
    "load_replay",
    "other_versions",
    "play_replay",
    "recorded_driver",
    "save_replay",
]
__dir__ = __all__.copy
