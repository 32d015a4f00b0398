"""Options for outputs of a race: a replay, the game's window, a video and a live page.

Each output has a function that adds its options and a function that creates its listeners.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stkzoo._arguments import CommandParser, add_options, changed_options, option
from stkzoo._os import check_display
from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

_SPEEDS = {"1": 1.0, "2": 2.0, "4": 4.0, "max": None}


def add_replay_options(parser: CommandParser) -> None:
    """Adds the option ``--replay``."""
    parser.group("output").add_argument(
        "--replay", metavar="FILE", help="record the race to FILE (.stkz), for stkzoo replay"
    )


def replay_listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """Returns the listeners for ``--replay``.

    Raises:
        ConfigError: the file is invalid, or there are several races.
    """
    if arguments.replay is None:
        return []
    if arguments.races > 1:
        raise ConfigError("--replay keeps one race; leave out --races")
    from stkzoo.race.replay import ReplayWriter

    return [ReplayWriter(arguments.replay)]


@dataclass
class WindowArguments:
    """Options of the game's window.

    Attributes:
        window: watch the race in the game
        hide: open no window (the default)
    """

    window: bool = option(False, rivals="window")
    hide: bool = option(False, rivals="window")


def _number_of_cameras(text: str) -> int | None:
    if text == "auto":
        return None
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor auto")
    return int(text)


@dataclass
class VideoArguments:
    """Options of a video.

    Attributes:
        cameras: number of agents with a camera, 1 to 8, or auto (default: up to 4)
        width: width of the video
        height: height of the video
        render_sub_steps: frames per step (usually 0.1 s)
        render_backend: engine draws the game in 3D; map draws it from above, ten times as fast;
            auto uses the game if it can draw here
        ghost: draw the winner of a replay (.stkz) of the same track on the map
    """

    cameras: int | None = option(metavar="N", type=_number_of_cameras)
    width: int = option(854, metavar="PIXELS")
    height: int = option(480, metavar="PIXELS")
    render_sub_steps: int = 3
    render_backend: str = option("auto", choices=("auto", "engine", "map"))
    ghost: str | None = option(metavar="FILE")


@dataclass
class LivePageArguments:
    """Options of the live page.

    Attributes:
        web: show the race on a page while it runs
        web_port: port of the page; 0 picks a free one
        web_host: address of the page; 0.0.0.0 lets other machines watch
        web_speed: initial speed, in multiples of real time
        web_wait: wait on the grid until a viewer presses Run
        web_stay: keep the page after the race, until Close or Ctrl-C
    """

    web: bool = False
    web_port: int = 8000
    web_host: str = option("127.0.0.1", metavar="ADDRESS")
    web_speed: str = option("1", choices=_SPEEDS)
    web_wait: bool = False
    web_stay: bool = False


def add_viewing_options(parser: CommandParser) -> None:
    """Adds the options for the window, videos and the live page."""
    add_options(parser, WindowArguments, group="game window")
    video = parser.group("video")
    formats = ".mp4, .mkv, .avi, .webm, .ogv, .mov, .gif"
    video.add_argument("--video", metavar="FILE", help=f"record a video to FILE: {formats}")
    add_options(parser, VideoArguments, group="video")
    add_options(parser, LivePageArguments, group="live page in the browser")


def viewing_listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """Returns the listeners for the options of :func:`add_viewing_options`.

    Raises:
        ConfigError: a value is invalid, the port is in use, or a library is missing.
    """
    found: list[RaceListener] = []
    if arguments.video is None:
        _check_unused(arguments, VideoArguments, "--video")
    if not arguments.web:
        _check_unused(arguments, LivePageArguments, "--web")
    if arguments.window:
        found.append(_window())
    if arguments.video is not None:
        found.append(_video(arguments))
    if arguments.web:
        found.append(_live_page(arguments))
    return found


def chosen_viewing_options(arguments: argparse.Namespace) -> list[str]:
    """Returns the options of :func:`add_viewing_options` that the user chose."""
    return [
        *changed_options(arguments, WindowArguments, only=("window",)),
        *(["--video"] if arguments.video is not None else []),
        *changed_options(arguments, VideoArguments),
        *changed_options(arguments, LivePageArguments),
    ]


def _check_unused(arguments: argparse.Namespace, kind: type, needed: str) -> None:
    """Rejects options that have no effect without another option.

    Args:
        arguments: the parsed arguments.
        kind: dataclass of the options.
        needed: the other option.

    Raises:
        ConfigError: such an option is given.
    """
    if unused := changed_options(arguments, kind):
        raise ConfigError(
            f"{unused[0]} does nothing without {needed}; add {needed}, or leave it out"
        )


def _window() -> RaceListener:
    check_display("--window opens the game's window", ", or --video FILE for a video")
    from stkzoo.race import RaceListener

    class Window(RaceListener):
        def env_options(self) -> dict[str, Any]:
            return {"render_mode": "human"}

    return Window()


def _video(arguments: argparse.Namespace) -> RaceListener:
    if arguments.races > 1:
        raise ConfigError("--video makes a video of one race; leave out --races")
    from stkzoo.race import RaceVideo
    from stkzoo.race.replay import ghost_of, load_replay

    return RaceVideo(
        arguments.video,
        cameras=arguments.cameras,
        size=(arguments.width, arguments.height),
        sub_steps=arguments.render_sub_steps,
        backend=arguments.render_backend,
        ghost=ghost_of(load_replay(arguments.ghost)) if arguments.ghost else None,
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
