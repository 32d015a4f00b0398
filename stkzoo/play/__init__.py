"""Driving with the keyboard, against the game's drivers or agents.

``gymnasium.utils.play.play`` needs nothing of this package; it drives any id of one kart
alone. Here a person is a driver of :func:`stkzoo.race.run_race` like any other.

>>> from stkzoo.play import play_race
>>> result = play_race(["heuristic", "ai"], track="lighthouse")  # doctest: +SKIP
"""

from stkzoo.play.dataset import DatasetWriter
from stkzoo.play.game import play_race
from stkzoo.play.screen import PlayScreen

__all__ = ["DatasetWriter", "PlayScreen", "play_race"]
