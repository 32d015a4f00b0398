"""Video files, encoded frame by frame."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
from pathlib import Path
from typing import IO, NoReturn, cast

import numpy as np
import numpy.typing as npt

from stkzoo._installation import install_command
from stkzoo._os import check_writable, write_whole
from stkzoo.engine.process import open_log, tail
from stkzoo.errors import ConfigError, StkzooError

_H264 = ("-c:v", "libx264", "-preset", "veryfast", "-crf", "21", "-pix_fmt", "yuv420p")
_VP9 = ("-c:v", "libvpx-vp9", "-deadline", "realtime", "-cpu-used", "6")
# Browsers show frames of less than 20 ms for 100 ms.
_GIF = (
    "fps='min(source_fps,50)',split[a][b];[a]palettegen=stats_mode=single[p];"
    "[b][p]paletteuse=new=1:dither=bayer"
)

#: Arguments of ffmpeg by file suffix.
FORMATS: dict[str, tuple[str, ...]] = {
    ".mp4": (*_H264, "-movflags", "+faststart", "-f", "mp4"),
    ".webm": (*_VP9, "-crf", "34", "-b:v", "0", "-pix_fmt", "yuv420p", "-f", "webm"),
    ".gif": ("-filter_complex", _GIF, "-loop", "0", "-f", "gif"),
}


class VideoError(StkzooError):
    """A video could not be written; no partial file remains."""


def check_video_path(path: str | os.PathLike[str]) -> Path:
    """Checks the path of a video to write.

    Args:
        path: path of the file; its suffix must be in :data:`FORMATS`.

    Raises:
        ConfigError: the suffix is unknown, the folder is not writable, or ffmpeg is missing.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise ConfigError(
            f"a video's name is {path.name!r}, expected one that ends with one of "
            f"{', '.join(FORMATS)}"
        )
    check_writable(path, "the video")
    find_ffmpeg()
    return path


def find_ffmpeg() -> str:
    """Returns the program ffmpeg.

    Raises:
        ConfigError: it is not installed or does not run.
    """
    try:
        import imageio_ffmpeg

        return cast("str", imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # RuntimeError: ffmpeg exists but does not run
        system_ffmpeg = shutil.which("ffmpeg")
        if system_ffmpeg is None:
            raise ConfigError(
                "videos need ffmpeg, which is not installed or does not run: "
                + install_command("races")
            ) from None
        return system_ffmpeg


class VideoWriter:
    """Writes one video until :meth:`close` or :meth:`abort`; a failure leaves no file.

    Frames are sent to ffmpeg immediately, so memory use is constant. The file appears under its
    name after :meth:`close` succeeds.

    Args:
        path: path of the file; its suffix selects one of :data:`FORMATS`.
        fps: frames per second.

    Raises:
        ConfigError: see :func:`check_video_path`.
    """

    def __init__(self, path: str | os.PathLike[str], fps: float) -> None:
        self.path = check_video_path(path)
        self.num_frames = 0
        self._fps = fps
        self._shape: tuple[int, int] | None = None
        self._rest = memoryview(b"")  # of the last frame, after an interrupt
        self._process: subprocess.Popen[bytes] | None = None
        self._resources = contextlib.ExitStack()

    def add(self, picture: npt.NDArray[np.uint8]) -> None:
        """Adds a frame, ``(H, W, 3)`` uint8; all frames must have the same size.

        If a dimension is odd, the last row or column is dropped, because most formats need even
        sizes. After Ctrl-C in this method, the video contains the frame and can continue.

        Raises:
            ConfigError: the frame has another size or dtype.
            VideoError: ffmpeg failed, for example because the disk is full.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ConfigError(
                f"a picture is {picture.dtype} of {picture.shape}, expected uint8 of (H, W, 3)"
            )
        height, width = picture.shape[0] & ~1, picture.shape[1] & ~1
        if self._process is None:
            self._start(height, width)
        if self._shape != (height, width):
            raise ConfigError(f"a picture is {width}x{height}, expected {self._shape}; resize it")
        self._send_rest()
        self._rest = np.ascontiguousarray(picture[:height, :width]).data.cast("B")
        self.num_frames += 1
        self._send_rest()

    def close(self) -> None:
        """Finishes the video and moves it to its path.

        Raises:
            VideoError: ffmpeg failed, or there were no frames.
        """
        if self._process is None:
            raise VideoError(f"{self.path} would have no picture; no file was written")
        self._send_rest()
        with contextlib.suppress(OSError):
            self._pipe.close()
        if (code := self._process.wait()) != 0:
            self._fail(f"ffmpeg ended with code {code}")
        self._resources.close()

    def abort(self) -> None:
        """Discards the video; you may call it again, or after :meth:`close`."""
        self._rest = memoryview(b"")
        with contextlib.suppress(_Aborted), self._resources:
            raise _Aborted

    def _start(self, height: int, width: int) -> None:
        self._shape = height, width
        layout = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}")
        source = (*layout, "-r", f"{self._fps:g}", "-i", "-")
        command = (find_ffmpeg(), "-y", "-hide_banner", "-loglevel", "error", *source, "-an")
        with contextlib.ExitStack() as resources:
            part = resources.enter_context(write_whole(self.path, "the video", VideoError))
            self._log = open_log()
            resources.callback(self._log.close)
            self._process = subprocess.Popen(  # noqa: S603 - ffmpeg with our own words
                (*command, *FORMATS[self.path.suffix.lower()], part),
                stdin=subprocess.PIPE,
                stdout=self._log.fileno(),
                stderr=self._log.fileno(),
                start_new_session=True,  # this program handles Ctrl-C and stops ffmpeg
            )
            self._pipe = cast("IO[bytes]", self._process.stdin)
            resources.enter_context(self._process)
            resources.callback(self._process.kill)
            self._resources = resources.pop_all()
        os.set_blocking(self._pipe.fileno(), False)

    def _send_rest(self) -> None:
        """Sends the rest of the last frame. A partial frame would shift all later frames."""
        poller = select.poll()
        poller.register(self._pipe, select.POLLOUT)
        try:
            while self._rest:
                poller.poll()
                self._rest = self._rest[os.write(self._pipe.fileno(), self._rest) :]
        except OSError as error:
            self._fail(f"ffmpeg is gone ({error})")

    def _fail(self, what: str) -> NoReturn:
        process = cast("subprocess.Popen[bytes]", self._process)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        last = tail(self._log)
        lines = f"\nffmpeg's last lines:\n{last}" if last else ""
        self.abort()
        free = shutil.disk_usage(self.path.absolute().parent).free // 2**20
        raise VideoError(
            f"{self.path} could not be written: {what}; {free} MB are free there. "
            f"No file was left.{lines}"
        )


class _Aborted(Exception):
    """Raised to stop writing without leaving a file."""
