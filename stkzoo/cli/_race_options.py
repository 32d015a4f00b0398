"""Options for outputs of a race: a replay, the game's window, a video and a live page."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from stkzoo._arguments import changed_options, option, options_of
from stkzoo._os import check_display
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, RaceVideo
from stkzoo.race.replay import ReplayWriter

_SPEEDS = {"1": 1.0, "2": 2.0, "4": 4.0, "max": None}


def replay_option() -> Any:
    """Returns a field for ``--replay``."""
    text = "record the race to FILE (.stkz), for stkzoo replay"
    return option(metavar="FILE", group="output", help=text)


def replay_listeners(replay: str | None) -> list[RaceListener]:
    """Returns the listeners for ``--replay``.

    Args:
        replay: the file; ``None`` for none.

    Raises:
        ConfigError: the file is invalid.
    """
    return [] if replay is None else [ReplayWriter(replay)]


@dataclass
class VideoArguments:
    """Options of a video.

    Attributes:
        video: record a video to FILE: .mp4, .webm or .gif
        cameras: number of agents with a camera, 1 to 8 (default: up to 4)
        width: width of the video
        height: height of the video
        render_sub_steps: frames per step (usually 0.1 s)
        render_backend: engine draws the game in 3D; map draws it from above, ten times as fast;
            auto uses the game if it can draw here
    """

    video: str | None = option(metavar="FILE", aliases=("--record",))
    cameras: int | None = None
    width: int = option(854, metavar="PIXELS", aliases=("--screen-width",))
    height: int = option(480, metavar="PIXELS", aliases=("--screen-height",))
    render_sub_steps: int = 3
    render_backend: str = option("auto", choices=("auto", "engine", "map"))


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
    """Options for the game's window, videos and the live page.

    Attributes:
        window: watch the race in the game
        hide: open no window (the default)
    """

    window: bool = option(False, rivals="window", group="game window")
    hide: bool = option(False, rivals="window", group="game window")
    video: VideoArguments = options_of(VideoArguments, group="video")
    page: LivePageArguments = options_of(LivePageArguments, group="live page in the browser")

    def unused(self, defaults: Mapping[str, Any] = MappingProxyType({})) -> list[str]:
        """Returns a sentence for each option that has no effect without another option.

        Args:
            defaults: as for :func:`~stkzoo._arguments.changed_options`.
        """
        parts: list[Any] = [] if self.video.video else [(self.video, "--video")]
        parts += [] if self.page.web else [(self.page, "--web")]
        return [
            f"{name} does nothing without {needed}"
            for options, needed in parts
            for name in changed_options(options, defaults=defaults)
        ]

    def listeners(self) -> list[RaceListener]:
        """Returns the listeners for these options.

        Raises:
            ConfigError: a value is invalid, the port is in use, or a library is missing.
        """
        if unused := self.unused():
            raise ConfigError(f"{unused[0]}; give both, or leave it out")
        listeners: list[RaceListener] = []
        if self.window:
            check_display("--window opens the game's window", ", or --video FILE for a video")
            listeners.append(EnvOptions(render_mode="human"))
        if self.video.video is not None:
            listeners.append(_video(self.video, self.video.video))
        if self.page.web:
            listeners.append(_live_page(self.page))
        return listeners


class EnvOptions(RaceListener):
    """Sets options of the race's environment.

    Args:
        **options: the options.
    """

    def __init__(self, **options: Any) -> None:
        self._options = options

    def env_options(self) -> dict[str, Any]:
        """Returns the options."""
        return self._options


def _video(video: VideoArguments, file: str) -> RaceListener:
    return RaceVideo(
        file,
        cameras=video.cameras,
        size=(video.width, video.height),
        sub_steps=video.render_sub_steps,
        backend=video.render_backend,
    )


def _live_page(options: LivePageArguments) -> RaceListener:
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
