"""Videos: all formats, no partial files, and videos of races."""

import itertools
import os
import re
import select
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from stkzoo.errors import ConfigError
from stkzoo.race import RaceVideo, run_race
from stkzoo.render import encoder
from stkzoo.render.encoder import FORMATS, VideoError, VideoWriter
from stkzoo.render.motion import game_time, poses_between, snapshots_between
from stkzoo.render.overlays import end_card
from stkzoo.render.pictures import grid_of, tiled
from tests.support.rendering import drive, small_race, who_draws

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()


def read(path):
    """Returns all frames of a video and its frame rate.

    Decodes in one thread, because ffmpeg's Theora decoder with several threads sometimes returns
    different frames for the same file.
    """
    said = subprocess.run([FFMPEG, "-i", path], capture_output=True, text=True).stderr
    width, height = map(int, re.search(r", (\d+)x(\d+)", said).groups())
    rate = float(re.search(r"([\d.]+) (?:fps|tbr)", said)[1])
    form = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough")
    command = [FFMPEG, "-loglevel", "error", "-threads", "1", "-i", path, *form, "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3), rate


@contextmanager
def video_writer(path):
    """Opens a video with 10 frames per second; discards it after an error."""
    writer = VideoWriter(path, 10)
    try:
        yield writer
    except BaseException:
        writer.abort()
        raise
    writer.close()


def overfill(writer, times=1000):
    """Adds more frames than fit in the pipe to ffmpeg."""
    for _ in range(times):
        writer.add(color(1))


def interrupted(path):
    """Writes a video and raises an error before its end."""
    with video_writer(path) as writer:
        writer.add(color(1))
        assert path.read_bytes() == b"an older video"
        raise ZeroDivisionError


def color(number, size=(64, 48)):
    return np.full((size[1], size[0], 3), number, np.uint8)


# ------------------------------------------------------------------ files


@pytest.mark.parametrize("ending", sorted(FORMATS))
def test_every_format_keeps_its_frames(tmp_path, ending):
    path = tmp_path / f"race{ending}"
    with video_writer(path) as writer:
        for number in range(0, 200, 10):
            writer.add(color(number))
    pictures, rate = read(path)
    assert (len(pictures), rate) == (20, 10)
    means = pictures.mean(axis=(1, 2, 3))
    np.testing.assert_allclose(means, np.arange(0, 200, 10), atol=8)
    assert list(tmp_path.iterdir()) == [path]


def test_no_file_appears_before_the_end_or_after_an_error(tmp_path):
    path = tmp_path / "race.mp4"
    path.write_bytes(b"an older video")
    with pytest.raises(ZeroDivisionError):
        interrupted(path)
    assert path.read_bytes() == b"an older video"
    assert list(tmp_path.iterdir()) == [path]


def test_an_ffmpeg_that_died_is_an_error_and_leaves_no_file(tmp_path):
    writer = VideoWriter(tmp_path / "race.mp4", 10)
    writer.add(color(1))
    os.kill(writer._process.pid, signal.SIGKILL)
    with pytest.raises(VideoError, match=r"could not be written: ffmpeg .* No file was left"):
        overfill(writer)
    assert list(tmp_path.iterdir()) == []
    writer.abort()


def interrupt_sending(monkeypatch, at):
    """Interrupts the program when it waits for ffmpeg for the given time."""
    poller, calls = select.poll(), itertools.count(1)

    class Poller:
        register = staticmethod(poller.register)

        def poll(self):
            if next(calls) == at:
                raise KeyboardInterrupt
            return poller.poll()

    monkeypatch.setattr(encoder.select, "poll", Poller)


def test_a_video_continues_after_an_interrupt_in_the_middle_of_a_frame(tmp_path, monkeypatch):
    path, big = tmp_path / "race.mp4", (640, 480)  # larger than the pipe to ffmpeg
    interrupt_sending(monkeypatch, at=2)
    writer = VideoWriter(path, 10)
    with pytest.raises(KeyboardInterrupt):
        writer.add(color(40, big))
    writer.add(color(200, big))
    writer.close()
    pictures, _ = read(path)
    assert [round(float(picture.mean()), -1) for picture in pictures] == [40, 200]


@pytest.mark.parametrize(
    ("name", "match"),
    [("race.mp5", "expected one that ends with"), ("no/such/race.mp4", "there is no folder")],
)
def test_an_invalid_path_is_refused_before_the_race(tmp_path, name, match):
    with pytest.raises(ConfigError, match=match):
        RaceVideo(tmp_path / name)


def test_frames_with_another_size_or_dtype_are_refused(tmp_path):
    with video_writer(tmp_path / "a.mp4") as video:
        video.add(color(1))
        with pytest.raises(ConfigError, match="resize it"):
            video.add(color(1, (32, 32)))
        with pytest.raises(ConfigError, match="expected uint8"):
            video.add(np.zeros((4, 4, 3)))
    with pytest.raises(VideoError, match="no picture"):
        VideoWriter(tmp_path / "a.mp4", 10).close()


# ------------------------------------------------------------------ between two steps


@pytest.fixture(scope="module")
def moments():
    with small_race() as env:
        return [now.snapshot for now in drive(env, 60)]


def test_interpolation_ends_at_the_steps_themselves(moments):
    before, after = moments[-2:]
    poses = poses_between(before, after, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(poses[0, :, :3], before.karts["location"], atol=1e-4)
    np.testing.assert_allclose(poses[2, :, :3], after.karts["location"], atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(poses[1, :, 3:7], axis=1), 1, atol=1e-5)


def test_a_kart_that_is_moved_elsewhere_is_not_interpolated(moments):
    after = moments[-1]
    karts = after.karts.copy()
    karts["location"][0] += [50, 0, 0]
    leapt = type(after).of(after.header, karts, after.items)
    places = poses_between(moments[-2], leapt, [0.5, 1.0])[:, 0, :3]
    np.testing.assert_allclose(places[0], moments[-2].karts["location"][0])
    np.testing.assert_allclose(places[1], karts["location"][0], rtol=1e-5)


def test_interpolated_snapshots_end_with_the_step(moments):
    between = snapshots_between(moments[-2], moments[-1], 3)
    assert len(between) == 3
    assert between[-1] is moments[-1]
    times = [moment.header["time"] for moment in between]
    assert np.diff([moments[-2].header["time"], *times]) == pytest.approx([0.1 / 3] * 3, abs=0.01)
    assert game_time(moments[-1]) - game_time(moments[-2]) == pytest.approx(0.1, abs=0.01)


# ------------------------------------------------------------------ videos of races


@pytest.mark.parametrize(("number", "grid"), [(1, (1, 1)), (2, (2, 1)), (3, (2, 2)), (8, (3, 3))])
def test_tiles_fill_a_grid(number, grid):
    assert grid_of(number) == grid
    whole = tiled([color(10 * (i + 1)) for i in range(number)], (120, 96))
    assert set(np.unique(whole)) <= {0, *(10 * (i + 1) for i in range(number))}
    assert whole.shape == (96, 120, 3)


@pytest.mark.parametrize("size", [(160, 120), (1920, 1080)])
def test_the_results_page_has_room_for_many_results(size):
    rows = [(rank, f"driver {rank}", "#e69f00", "1:02.3") for rank in range(1, 31)]
    assert end_card("lighthouse", "results", rows, None, size).shape == (size[1], size[0], 3)


def test_a_video_is_as_long_as_the_race_and_does_not_change_it(tmp_path):
    path = tmp_path / "race.mp4"
    video = RaceVideo(path, backend="map", size=(160, 120), sub_steps=3, card_seconds=1.0)
    settings = {"track": "lighthouse", "seed": 1, "max_steps": 40}
    result = run_race(["ai", "ai"], **settings, listeners=[video])
    assert result == run_race(["ai", "ai"], **settings)  # D19
    pictures, rate = read(path)
    assert rate == 30
    assert len(pictures) == 1 + 3 * result.steps + 30


def test_a_race_that_fails_leaves_no_video(tmp_path):
    video = RaceVideo(tmp_path / "race.mp4", backend="map", size=(160, 120))
    video.stepped = lambda _: 1 / 0
    with pytest.raises(ZeroDivisionError):
        run_race(["ai"], track="lighthouse", seed=1, max_steps=5, listeners=[video])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cameras", 9),
        ("cameras", 0),
        ("sub_steps", 0),
        ("card_seconds", float("nan")),
        ("card_seconds", -1),
    ],
)
def test_numbers_out_of_range_are_refused(tmp_path, name, value):
    with pytest.raises(ConfigError, match=f"{name} is {value}"):
        RaceVideo(tmp_path / "race.mp4", **{name: value})


@pytest.mark.slow
def test_the_game_renders_the_video_where_it_can(tmp_path):
    path = tmp_path / "race.mp4"
    video = RaceVideo(path, cameras=3, size=(320, 240), sub_steps=1, card_seconds=0.5)
    settings = {"track": "lighthouse", "seed": 1, "max_steps": 12}
    filmed = run_race(["ai", "ai", "ai"], listeners=[video], **settings)
    assert filmed == run_race(["ai", "ai", "ai"], **settings)
    assert video.backend == who_draws()
    pictures, _ = read(Path(path))
    assert len(pictures) == 1 + 12 + 5
    assert len(np.unique(pictures[5].reshape(-1, 3), axis=0)) > 100
