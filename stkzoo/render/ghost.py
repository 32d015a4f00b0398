"""The ghost of an earlier race, which maps show beside a race."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stkzoo.errors import ConfigError


@dataclass(frozen=True, eq=False)
class Ghost:
    """The way of one kart in an earlier race.

    Attributes:
        track: name of the track.
        reverse: whether it was driven in reverse.
        name: display name of the driver.
        times: ``(T,)`` race times [s], increasing from 0.
        places: ``(T, 2)`` x and z at these times [m], world frame.
    """

    track: str
    reverse: bool
    name: str
    times: npt.NDArray[np.float64]
    places: npt.NDArray[np.float64]

    def check_track(self, track: str, *, reverse: bool) -> None:
        """Checks that a race has the ghost's track and direction.

        Raises:
            ConfigError: it has another one.
        """
        if (track, reverse) != (self.track, self.reverse):
            ways = [
                name + " in reverse" * way
                for name, way in ((self.track, self.reverse), (track, reverse))
            ]
            raise ConfigError(
                f"the ghost drives on {ways[0]} and this race is on {ways[1]}; "
                "use a replay of the same track and direction"
            )

    def place_at(self, time: float) -> npt.NDArray[np.float64] | None:
        """Returns where the kart was, ``(2,)``; ``None`` after its finish.

        Args:
            time: race time [s].
        """
        if time > self.times[-1]:
            return None
        return np.array([np.interp(time, self.times, column) for column in self.places.T])
