"""What can be attached to a race: a replay, the game's window, a video, a live page.

Each has a function that adds its options and one that makes its listeners.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

_SPEEDS = {"1": 1.0, "2": 2.0, "4": 4.0, "max": None}


def add_replay_options(parser: argparse.ArgumentParser) -> None:
    """Adds ``--replay``."""
    group = parser.add_argument_group("a replay")
    group.add_argument(
        "--replay", metavar="FILE", help="keep the race in FILE (.stkz), for `stkzoo replay FILE`"
    )


def replay_listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """The listeners for ``--replay``.

    Raises:
        ConfigError: the file is invalid.
    """
    if arguments.replay is None:
        return []
    if arguments.races > 1:
        raise ConfigError("--replay keeps one race; leave out --races")
    from stkzoo.race.replay import ReplayWriter

    return [ReplayWriter(arguments.replay)]


def add_viewing_options(parser: argparse.ArgumentParser, video_option: str) -> None:
    """Adds the options for the window, videos and the live page."""
    choice = parser.add_argument_group("the game's window").add_mutually_exclusive_group()
    choice.add_argument("--window", action="store_true", help="watch the race in the game")
    choice.add_argument("--hide", action="store_true", help="open no window (the default)")
    _add_video_options(parser.add_argument_group("a video"), video_option)
    _add_web_options(parser.add_argument_group("a live page in the browser"))


def _add_video_options(group: argparse._ArgumentGroup, option: str) -> None:
    formats = ".mp4, .mkv, .avi, .webm, .ogv, .mov, .gif"
    group.add_argument(option, dest="video", metavar="FILE", help=f"make a video: {formats}")
    group.add_argument(
        "--cameras", type=int, metavar="N", help="agents with a camera, 1 to 8 (default: up to 4)"
    )
    for name, default in (("width", 854), ("height", 480)):
        group.add_argument(
            f"--screen-{name}",
            type=int,
            default=default,
            metavar="PIXELS",
            help=f"{name} of the picture (default: %(default)s)",
        )
    group.add_argument(
        "--render-sub-steps",
        type=int,
        default=3,
        metavar="N",
        help="pictures per step, with ten steps per second (default: %(default)s)",
    )


def _add_web_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--web", action="store_true", help="show the race on a page while it runs")
    group.add_argument(
        "--web-port",
        type=int,
        default=8000,
        metavar="N",
        help="its port; 0 takes a free one (default: %(default)s)",
    )
    group.add_argument(
        "--web-host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="its address; 0.0.0.0 lets other machines watch (default: %(default)s)",
    )
    group.add_argument(
        "--web-speed",
        choices=_SPEEDS,
        default="1",
        help="times real time at the start (default: %(default)s)",
    )
    group.add_argument(
        "--web-wait", action="store_true", help="wait on the grid until a viewer presses Run"
    )
    group.add_argument(
        "--web-stay",
        action="store_true",
        help="keep the page after the race, until Close or Ctrl-C",
    )


def viewing_listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """The listeners for the options of :func:`add_viewing_options`.

    Raises:
        ConfigError: a value is invalid, the port is in use, or a library is missing.
    """
    found: list[RaceListener] = []
    if arguments.window:
        found.append(_window())
    if arguments.video is not None:
        found.append(_video(arguments))
    if arguments.web:
        found.append(_live_page(arguments))
    return found


def _window() -> RaceListener:
    from stkzoo.race import RaceListener

    class Window(RaceListener):
        def env_options(self) -> dict[str, Any]:
            return {"render_mode": "human"}

    return Window()


def _video(arguments: argparse.Namespace) -> RaceListener:
    if arguments.races > 1:
        raise ConfigError("--record makes a video of one race; leave out --races")
    from stkzoo.race import RaceVideo

    return RaceVideo(
        arguments.video,
        cameras=arguments.cameras,
        size=(arguments.screen_width, arguments.screen_height),
        sub_steps=arguments.render_sub_steps,
    )


def _live_page(arguments: argparse.Namespace) -> RaceListener:
    if arguments.races > 1 and arguments.web_stay:
        raise ConfigError("--web-stay is for one race; leave out --races")
    from stkzoo.race.web import LivePage

    page = LivePage(
        host=arguments.web_host,
        port=arguments.web_port,
        speed=_SPEEDS[arguments.web_speed],
        paused=arguments.web_wait,
        stay=arguments.web_stay,
    )
    arguments.web_port = page.port  # the following races use the same port
    print(f"live page: {page.url}", file=sys.stderr, flush=True)
    return page
