"""Ghosts: the winner of a replay, for the map of another race."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.errors import ConfigError
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay.file import Replay, ReplayError
from stkzoo.race.replay.playback import play_replay
from stkzoo.render.ghost import Ghost


def ghost_of(replay: Replay) -> Ghost:
    """Plays a replay and returns the way of its winner until the finish.

    Args:
        replay: the recorded race.

    Raises:
        ReplayError: the replay cannot be played (see :func:`.play_replay`), or the race differs
            from the recording.
        ConfigError: the race ended before it started to count the time.
    """
    recorder = _Recorder()
    playback = play_replay(replay, listeners=[recorder])
    if playback.first_difference is not None:
        raise ReplayError(
            f"the replay has no ghost: its race differs after step {playback.first_difference} of "
            f"{replay.steps}; expected a race that runs as recorded, see `stkzoo replay FILE`"
        )
    times = np.array(recorder.times)
    begin = int(np.flatnonzero(times <= 0)[-1])
    end = np.searchsorted(times, recorder.finish_time) if recorder.finish_time else len(times) - 1
    if begin >= end:
        raise ConfigError("the replay ends before the race begins; record a longer one")
    rows = slice(begin, int(end) + 1)
    places = np.array(recorder.places[rows], np.float64)[:, recorder.winner]
    return Ghost(replay.track, replay.reverse, recorder.winner_name, times[rows], places)


class _Recorder(RaceListener):
    """Records the race times and the places of all karts."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.places: list[npt.NDArray[np.float32]] = []
        self.finish_time = 0.0

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.stepped(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        karts = race.snapshot.karts
        self.times.append(float(race.snapshot.header["time"]))
        self.places.append(karts["location"][:, ::2].copy())
        self.winner = int(karts["position"].argmin())
        self.winner_name = race.scene.names[self.winner]
        if karts["has_finished_race"][self.winner]:
            self.finish_time = float(karts["finish_time"][self.winner])
