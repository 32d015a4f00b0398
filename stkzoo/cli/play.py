"""``stkzoo play``: drive yourself."""

from __future__ import annotations

import argparse
import random
from typing import Any

from stkzoo.cli import race_replay
from stkzoo.cli.flags import add_flags, flags_given
from stkzoo.errors import ConfigError

__all__ = ["add_parser"]

_ABOUT = """\
Opens a window and lets you drive, in real time, against the drivers named: the game's ai
(three of them if nobody is named), heuristic, random, or agents of files, as in `stkzoo race`.

  arrows      throttle, brake, steer          P     pause
  V           drift, while steering           Esc   leave
  space       fire what you have picked up
  N           nitro
  backspace   be put back on the road
"""

_EXAMPLES = """\
examples:
  stkzoo play                                    against three bots, on a track drawn by lot
  stkzoo play heuristic my_agent/ --track hacienda
  stkzoo play --map --track lighthouse           from above, where 3D is slow
  stkzoo play --dataset me.npz                   what you see and do, to learn from
  stkzoo play --replay me.stkz                   the race, to watch again
"""

#: What a dataset is recorded in, and how often, unless the user says: as the ids step.
_DATASET_VIEW, _DATASET_RATE, _RATE = "flattened_discrete", 10, 20


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    from stkzoo.race import RaceSettings

    parser = subparsers.add_parser(
        "play",
        help="drive yourself, with the keyboard",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("opponents", nargs="*", metavar="DRIVER", help="who else drives")
    parser.add_argument("--name", default="you", help="what to call you (default: %(default)s)")
    parser.add_argument("--seed", type=int, metavar="N", help="decides all that is left to chance")
    _add_window_flags(parser.add_argument_group("the window"))
    _add_dataset_flags(parser.add_argument_group("a dataset"))
    add_flags(parser.add_argument_group("the race"), RaceSettings, leave_out=("seed",))
    race_replay.add_flags(parser)
    parser.set_defaults(run=_play, fail=parser.error, races=1)


def _add_window_flags(group: argparse._ArgumentGroup) -> None:
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


def _add_dataset_flags(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--dataset", metavar="FILE", help="keep what you drive in FILE (.npz)")
    group.add_argument(
        "--view",
        metavar="VIEW",
        help=f"its observations and actions (default: {_DATASET_VIEW}): simple or a flattened one",
    )


def _play(arguments: argparse.Namespace) -> int:
    from stkzoo.cli.race_report import show_race
    from stkzoo.play import play_race
    from stkzoo.race import RaceInterrupted, RaceSettings

    try:
        result = play_race(
            arguments.opponents or ("ai", "ai", "ai"),
            name=arguments.name,
            backend=_backend(arguments),
            size=(arguments.width, arguments.height),
            listeners=race_replay.listeners(arguments),
            seed=random.randrange(2**16) if arguments.seed is None else arguments.seed,
            **_recording(arguments),
            **flags_given(arguments, RaceSettings, leave_out=("seed",)),
        )
    except ConfigError as error:
        arguments.fail(str(error))
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
            raise ConfigError("--view says what a dataset is recorded in; give --dataset too")
        return {"rate": arguments.rate or _RATE}
    return {
        "rate": arguments.rate or _DATASET_RATE,
        "view": arguments.view or _DATASET_VIEW,
        "dataset": arguments.dataset,
    }
