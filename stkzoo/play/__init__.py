"""Keyboard driving in a race against the game's AI or other agents.

``gymnasium.utils.play.play`` works without this package, for one kart of any id. In this package, a
person is a driver of :func:`stkzoo.race.run_race`.

>>> from stkzoo.play import play_race
>>> result = play_race(["heuristic", "ai"], track="lighthouse")  # doctest: +SKIP
"""

from stkzoo.play.game import DatasetWriter, play_race
from stkzoo.play.screen import PlayScreen

__all__ = ["DatasetWriter", "PlayScreen", "play_race"]
__dir__ = __all__.copy
