"""The flags of ``stkzoo race`` for videos."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

__all__ = ["add_flags", "listeners"]

_WIDTH, _HEIGHT = 854, 480


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags."""
    group = parser.add_argument_group("a video")
    group.add_argument(
        "--record", metavar="FILE", help="make a video: .mp4, .mkv, .avi, .webm, .ogv, .mov, .gif"
    )
    group.add_argument(
        "--cameras", type=int, metavar="N", help="agents with a camera, 1 to 8 (default: up to 4)"
    )
    for name, size in (("width", _WIDTH), ("height", _HEIGHT)):
        group.add_argument(
            f"--screen-{name}",
            type=int,
            default=size,
            metavar="PIXELS",
            help=f"{name} of the picture (default: %(default)s)",
        )
    group.add_argument(
        "--render-sub-steps",
        type=int,
        default=3,
        metavar="N",
        help="pictures a step, of which there are ten a second (default: %(default)s)",
    )


def listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """What the flags ask for.

    Raises:
        ConfigError: a value cannot be, or a library is missing.
    """
    if arguments.record is None:
        return []
    if arguments.races > 1:
        raise ConfigError("--record makes a video of one race; leave out --races")
    from stkzoo.race import RaceVideo

    video = RaceVideo(
        arguments.record,
        cameras=arguments.cameras,
        size=(arguments.screen_width, arguments.screen_height),
        sub_steps=arguments.render_sub_steps,
    )
    return [video]
