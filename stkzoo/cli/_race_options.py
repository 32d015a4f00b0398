"""Options for outputs of a race: a replay, the game's window, a video and a live page."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import Any

from stkzoo._arguments import changed_options, option, options_of
from stkzoo._os import check_display
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, RaceVideo
from stkzoo.race.replay import ReplayWriter, ghost_of, load_replay

_SPEEDS = {"1": 1.0, "2": 2.0, "4": 4.0, "max": None}


def replay_option() -> Any:
    """Returns a field for ``--replay``."""
    text = "record the race to FILE (.stkz), for stkzoo replay"
    return option(metavar="FILE", group="output", help=text)


def replay_listeners(replay: str | None, races: int = 1) -> list[RaceListener]:
    """Returns the listeners for ``--replay``.

    Args:
        replay: the file; ``None`` for none.
        races: number of races.

    Raises:
        ConfigError: the file is invalid, or there are several races.
    """
    if replay is None:
        return []
    if races > 1:
        raise ConfigError("--replay keeps one race; leave out --races")
    return [ReplayWriter(replay)]


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
        video: record a video to FILE: .mp4, .mkv, .avi, .webm, .ogv, .mov, .gif
        cameras: number of agents with a camera, 1 to 8, or auto (default: up to 4)
        width: width of the video
        height: height of the video
        render_sub_steps: frames per step (usually 0.1 s)
        render_backend: engine draws the game in 3D; map draws it from above, ten times as fast;
            auto uses the game if it can draw here
        ghost: draw the winner of a replay (.stkz) of the same track on the map
    """

    video: str | None = option(metavar="FILE")
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


@dataclass
class ViewingArguments:
    """Options for the window, videos and the live page."""

    window: WindowArguments = options_of(WindowArguments, group="game window")
    video: VideoArguments = options_of(VideoArguments, group="video")
    page: LivePageArguments = options_of(LivePageArguments, group="live page in the browser")

    def unused(self) -> list[tuple[VideoArguments | LivePageArguments, str]]:
        """Returns options that have no effect without another option, and that option."""
        is_unused = (
            (self.video, "--video", self.video.video is None),
            (self.page, "--web", not self.page.web),
        )
        return [(options, needed) for options, needed, is_so in is_unused if is_so]

    def listeners(self, races: int = 1) -> list[RaceListener]:
        """Returns the listeners for these options.

        Args:
            races: number of races.

        Raises:
            ConfigError: a value is invalid, the port is in use, or a library is missing.
        """
        for options, needed in self.unused():
            if chosen := changed_options(options):
                raise ConfigError(
                    f"{chosen[0]} does nothing without {needed}; add {needed}, or leave it out"
                )
        found: list[RaceListener] = []
        if self.window.window:
            found.append(_window())
        if self.video.video is not None:
            found.append(_video(self.video, self.video.video, races))
        if self.page.web:
            found.append(_live_page(self.page, races))
        return found


def _window() -> RaceListener:
    check_display("--window opens the game's window", ", or --video FILE for a video")

    class Window(RaceListener):
        def env_options(self) -> dict[str, Any]:
            return {"render_mode": "human"}

    return Window()


def _video(video: VideoArguments, file: str, races: int) -> RaceListener:
    if races > 1:
        raise ConfigError("--video makes a video of one race; leave out --races")
    return RaceVideo(
        file,
        cameras=video.cameras,
        size=(video.width, video.height),
        sub_steps=video.render_sub_steps,
        backend=video.render_backend,
        ghost=ghost_of(load_replay(video.ghost)) if video.ghost else None,
    )


def _live_page(options: LivePageArguments, races: int) -> RaceListener:
    if races > 1 and options.web_stay:
        raise ConfigError("--web-stay is for one race; leave out --races")
    from stkzoo.race.web import LivePage  # an extra

    page = LivePage(
        host=options.web_host,
        port=options.web_port,
        speed=_SPEEDS[options.web_speed],
        paused=options.web_wait,
        stay=options.web_stay,
    )
    options.web_port = page.port  # the following races use the same port
    print(f"live page: {page.url}", file=sys.stderr, flush=True)
    return page
