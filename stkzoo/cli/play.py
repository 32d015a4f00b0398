"""Drive yourself, with the keyboard.

Opens a window in which you drive in real time against other drivers: the game's ai (three karts
by default), heuristic, random, or agents from files, as in `stkzoo race`.

  arrows      throttle, brake, steer          P     pause
  V           drift, while steering           Esc   leave
  space       fire the collected item
  N           nitro
  backspace   return to the road

Examples:
  stkzoo play                             against three karts of the game's AI
  stkzoo play heuristic my_agent/ --track hacienda
  stkzoo play --map --track lighthouse    a map, where 3D is slow
  stkzoo play --dataset me.safetensors    record your observations and actions
  stkzoo play --replay me.stkz            record the race
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import option, options_of, positional
from stkzoo.cli._process import AGENT_FAILED, INTERRUPTED
from stkzoo.cli._race_options import replay_listeners, replay_option
from stkzoo.cli._race_report import show_race
from stkzoo.errors import ConfigError
from stkzoo.play import play_race
from stkzoo.race import RaceInterrupted, RaceSettings

#: Default view and rate of a dataset, those of supertuxkart/flattened_discrete-v0; and the default
#: rate without a dataset.
_DATASET_VIEW, _DATASET_RATE, _RATE = "flattened_discrete", 10, 20


@dataclass
class PlayArguments:
    """Options of ``stkzoo play``.

    Attributes:
        opponents: the other drivers
        name: your name
        seed: seed of all random choices (default: a new one each time)
        map: show a map instead of 3D graphics
        is_3d: show 3D graphics; fail if this machine cannot draw them
        width: width of the window
        height: height of the window
        rate: steps per second: 10, 12, 15, 20, 30 or 60 (default: 20; 10 with --dataset, as
            environments step)
        dataset: record your observations and actions to FILE (.safetensors)
        view: view of the dataset, of fixed size, such as simple or racing (default:
            flattened_discrete)
    """

    opponents: tuple[str, ...] = positional((), metavar="DRIVER")
    name: str = "you"
    seed: int | None = None
    map: bool = option(False, rivals="backend", group="window")
    is_3d: bool = option(False, flag="--3d", rivals="backend", group="window")
    width: int = option(640, metavar="PIXELS", group="window")
    height: int = option(480, metavar="PIXELS", group="window")
    rate: int | None = option(group="window")
    dataset: str | None = option(metavar="FILE", group="output")
    view: str | None = option(group="output")
    settings: dict[str, Any] = options_of(RaceSettings, without=("seed",), group="race")
    replay: str | None = replay_option()


def run(arguments: PlayArguments) -> int:
    """Opens the window and runs the race."""
    if arguments.view is not None and arguments.dataset is None:
        raise ConfigError("--view is the view of a dataset; give --dataset too")
    view, rate = ("full", _RATE) if arguments.dataset is None else (_DATASET_VIEW, _DATASET_RATE)
    try:
        result = play_race(
            arguments.opponents or ("ai", "ai", "ai"),
            name=arguments.name,
            backend="map" if arguments.map else "engine" if arguments.is_3d else "auto",
            size=(arguments.width, arguments.height),
            rate=rate if arguments.rate is None else arguments.rate,
            view=arguments.view or view,
            dataset=arguments.dataset,
            listeners=replay_listeners(arguments.replay),
            seed=random.randrange(2**16) if arguments.seed is None else arguments.seed,
            **arguments.settings,
        )
    except RaceInterrupted as interrupt:
        show_race(interrupt.result)
        return INTERRUPTED
    show_race(result)
    return AGENT_FAILED if result.has_errors else 0
