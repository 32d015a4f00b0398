"""Drive yourself, with the keyboard.

Opens a window and lets you drive, in real time, against other drivers: the game's ai (three of
them by default), heuristic, random, or agents from files, as in `stkzoo race`.

  arrows      throttle, brake, steer          P     pause
  V           drift, while steering           Esc   leave
  space       fire the collected item
  N           nitro
  backspace   return to the road
"""

from __future__ import annotations

import argparse
import random
from typing import Any

from stkzoo.cli._arguments import add_settings, settings_of, usage_errors
from stkzoo.cli._race_options import add_replay_options, replay_listeners
from stkzoo.errors import ConfigError

EXAMPLES = """\
examples:
  stkzoo play                                    against three bots, on a random track
  stkzoo play heuristic my_agent/ --track hacienda
  stkzoo play --map --track lighthouse           from above, where 3D is slow
  stkzoo play --dataset me.npz                   your observations and actions, to learn from
  stkzoo play --replay me.stkz                   the race, to replay
"""

#: Default view and rate of a dataset, which are those of the ids; default rate without one.
_DATASET_VIEW, _DATASET_RATE, _RATE = "flattened_discrete", 10, 20
_DECIDED = ("seed",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments."""
    parser.add_argument("opponents", nargs="*", metavar="DRIVER", help="the other drivers")
    parser.add_argument("--name", default="you", help="your name (default: %(default)s)")
    parser.add_argument("--seed", type=int, metavar="N", help="of all random choices")
    _add_window_options(parser.add_argument_group("the window"))
    _add_dataset_options(parser.add_argument_group("a dataset"))
    add_settings(parser, "the race", _DECIDED)
    add_replay_options(parser)
    parser.set_defaults(races=1)


def _add_window_options(group: argparse._ArgumentGroup) -> None:
    choice = group.add_mutually_exclusive_group()
    choice.add_argument("--map", action="store_true", help="draw the race from above")
    choice.add_argument("--3d", action="store_true", dest="is_3d", help="the game's pictures only")
    group.add_argument("--width", type=int, default=640, metavar="PIXELS", help="(default: 640)")
    group.add_argument("--height", type=int, default=480, metavar="PIXELS", help="(default: 480)")
    group.add_argument(
        "--rate",
        type=int,
        metavar="N",
        help=f"steps a second: 10, 12, 15, 20, 30 or 60 (default: {_RATE}; {_DATASET_RATE} with "
        "--dataset, as environments step)",
    )


def _add_dataset_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--dataset", metavar="FILE", help="record your drive in FILE (.npz)")
    group.add_argument(
        "--view",
        metavar="VIEW",
        help=f"its observations and actions (default: {_DATASET_VIEW}): simple or a flattened one",
    )


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Opens the window and races."""
    from stkzoo.cli._race_report import show_race
    from stkzoo.play import play_race
    from stkzoo.race import RaceInterrupted

    try:
        result = play_race(
            arguments.opponents or ("ai", "ai", "ai"),
            name=arguments.name,
            backend=_backend(arguments),
            size=(arguments.width, arguments.height),
            listeners=replay_listeners(arguments),
            seed=random.randrange(2**16) if arguments.seed is None else arguments.seed,
            **_recording(arguments),
            **settings_of(arguments, _DECIDED),
        )
    except RaceInterrupted as interrupt:
        show_race(interrupt.result)
        return 130
    show_race(result)
    return 3 if result.has_errors else 0


def _backend(arguments: argparse.Namespace) -> str:
    if arguments.map:
        return "map"
    return "engine" if arguments.is_3d else "auto"


def _recording(arguments: argparse.Namespace) -> dict[str, Any]:
    if arguments.dataset is None:
        if arguments.view is not None:
            raise ConfigError("--view is the view of a dataset; give --dataset too")
        return {"rate": arguments.rate or _RATE}
    return {
        "rate": arguments.rate or _DATASET_RATE,
        "view": arguments.view or _DATASET_VIEW,
        "dataset": arguments.dataset,
    }
