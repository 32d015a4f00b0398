"""Render modes, cameras and render backends."""

import functools
import os
import shutil
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from PIL import ImageGrab

import stkzoo  # noqa: F401 - registers the ids
from stkzoo import AgentSpec, race_v0
from stkzoo.engine import render_session
from stkzoo.engine.assets import DATADIR_VARIABLE
from stkzoo.errors import ConfigError, EngineCrashed
from stkzoo.names import CameraMode
from tests.support.processes import wait_until
from tests.support.rendering import drive, frames_of, history, small_race, who_draws
from tests.support.views import marked

SMALL = (96, 64)
MAP = {"render_backend": "map", "render_size": SMALL}


@pytest.fixture
def no_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("stkzoo._os.sys.platform", "linux")


def is_picture(picture, size=SMALL):
    return (picture.shape, picture.dtype) == ((size[1], size[0], 3), np.uint8)


# ------------------------------------------------------------------ modes


def test_rgb_array_returns_the_current_frame():
    with small_race(render_mode="rgb_array", **MAP) as env:
        pictures = [now.render() for now in drive(env, 50)]
    assert all(map(is_picture, pictures))
    assert (pictures[0] != pictures[-1]).any()


@pytest.mark.slow
def test_the_list_of_frames_of_a_gymnasium_id_has_those_since_the_last_call():
    options = {"track": "lighthouse", "num_kart": 1, **MAP}
    with gym.make("supertuxkart/full-v0", render_mode="rgb_array_list", **options) as env:
        env.reset(seed=1)
        for _ in range(2):
            env.step(env.action_space.sample())
        pictures = env.render()
        assert len(pictures) == 3  # of the reset and two steps
        assert all(map(is_picture, pictures))
        env.reset(seed=1)
        assert len(env.render()) == 1


def test_aec_envs_render_too():
    env = race_v0.env(num_kart=2, track="lighthouse", render_mode="rgb_array", **MAP)
    env.reset(seed=1)
    assert is_picture(env.render())
    env.close()


@pytest.mark.parametrize("name", ["flattened_discrete", "multi-full"])
def test_gymnasium_ids_render(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gym.make(
            f"supertuxkart/{name}-v0", render_mode="rgb_array", track="lighthouse", **MAP
        )
    env.reset(seed=1)
    assert is_picture(env.render())
    env.close()


def test_render_fps_follows_the_step_size():
    with small_race(step_size=0.05) as env:
        assert env.metadata["render_fps"] == 20
    env = gym.make("supertuxkart/full-v0", step_size=0.3, disable_env_checker=True)
    assert env.metadata["render_fps"] == pytest.approx(10 / 3)
    env.close()
    with small_race() as env:  # other environments keep the default
        assert env.metadata["render_fps"] == 10


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"render_mode": "rgb"}, "expected None or one of human, rgb_array"),
        ({"render_backend": "vulkan"}, "unknown render_backend"),
        ({"render_mode": "human", "render_backend": "map"}, "opens the game's window"),
        ({"render_size": (0, 10)}, "expected \\(width, height\\)"),
        ({"render_size": "640x480"}, "expected \\(width, height\\)"),
        ({"render_size": (5000, 480)}, "from 32 to 4096"),
        ({"num_cameras": 9}, "num_cameras is 9, expected a whole number from 0 to 8"),
    ],
)
def test_invalid_options_are_refused(options, match):
    with pytest.raises(ConfigError, match=match):
        small_race(**options)


@pytest.mark.usefixtures("no_display")
def test_a_window_without_a_display_is_refused_at_reset():
    with small_race(render_mode="human") as env:
        assert "human" not in env.metadata["render_modes"]
        expected = "no display is named by DISPLAY or WAYLAND_DISPLAY; start .* `xvfb-run`"
        with pytest.raises(ConfigError, match=expected):
            env.reset()


@pytest.mark.parametrize("variable", ["DISPLAY", "WAYLAND_DISPLAY"])
@pytest.mark.usefixtures("no_display")
def test_human_is_a_render_mode_where_a_display_is_named(variable, monkeypatch):
    monkeypatch.setenv(variable, ":4095")
    with small_race() as env:
        assert "human" in env.metadata["render_modes"]


@pytest.mark.usefixtures("no_display")
def test_environments_pass_gymnasiums_checks_with_sdls_dummy_driver(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("supertuxkart/simple-v0", track="lighthouse", **MAP)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        check_env(env.unwrapped)
    env.close()
    window = gym.make("supertuxkart/simple-v0", track="lighthouse", render_mode="human")
    with pytest.raises(ConfigError, match="no display is named by DISPLAY"):
        window.reset()
    window.close()


@pytest.mark.slow
@pytest.mark.usefixtures("no_display")
def test_a_window_on_a_display_that_ends_is_an_error(monkeypatch):
    if who_draws() == "map":
        pytest.skip("no graphics libraries here; missing ones have a test of their own")
    monkeypatch.setenv("DISPLAY", ":4095")
    with (
        small_race(render_mode="human", render_size=SMALL) as env,
        pytest.raises(EngineCrashed, match=r"could not open its window; .* `xvfb-run`"),
    ):
        env.reset(seed=1)


class Display:
    """A virtual X server that can take screenshots."""

    def __init__(self):
        self.pictures = []
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", "1", "-screen", "0", "320x240x24", "-nolisten", "tcp"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.name = f":{self._server.stdout.readline().strip()}"

    def shoot(self):
        self.pictures.append(np.asarray(ImageGrab.grab(xdisplay=self.name)))

    def close(self):
        self._server.terminate()
        self._server.communicate(timeout=10)


@pytest.fixture
def display(monkeypatch):
    if shutil.which("Xvfb") is None or who_draws() == "map":
        pytest.skip("needs Xvfb and the graphics libraries; `make graphics` installs them")
    display = Display()
    for name in ("WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", display.name)
    yield display
    display.close()


@pytest.mark.slow
def test_the_window_follows_the_race(display):
    with small_race(render_mode="human", render_size=(320, 240), num_cameras=1) as env:
        moments = []
        for now in drive(env, 25):
            moments.append(now.snapshot.data)
            if len(moments) in (15, 26):
                display.shoot()
        assert env.render() is None
        process = env.live_race.rendering._renderer._game._session.pid
        variables = Path(f"/proc/{process}/environ").read_text().split("\0")
    (data,) = (Path(v.partition("=")[2]) for v in variables if v.startswith(DATADIR_VARIABLE))
    assert (data.name.startswith("window-"), data.exists()) == (True, False)
    first, last = display.pictures
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 300
    assert (first != last).any(axis=2).mean() > 0.02
    assert moments == history(25)


# ------------------------------------------------------------------ cameras


def test_the_first_agents_have_the_cameras():
    agents = [AgentSpec(), AgentSpec(), AgentSpec()]
    with small_race(agents=agents, num_cameras=2, **MAP) as env:
        for now in drive(env, 3):
            frames = frames_of(now)
    assert list(frames) == ["kart_0", "kart_1"]
    assert all(map(is_picture, frames.values()))


def test_agents_can_request_a_camera():
    agents = [AgentSpec(), AgentSpec(camera_mode=CameraMode.ON), AgentSpec()]
    with small_race(agents=agents, **MAP) as env:
        env.reset(seed=1)
        assert list(frames_of(env)) == ["kart_1"]


def test_a_camera_in_a_race_without_graphics_is_harmless():
    assert history(5, num_cameras=3) == history(5)


# ------------------------------------------------------------------ effects on the race


def test_the_map_does_not_change_the_race():
    assert history(render_mode="rgb_array", **MAP) == history()


# ------------------------------------------------------------------ the game's renderer


@pytest.mark.slow
def test_the_game_or_else_the_map_draws_without_changing_the_race(caplog):
    options = {"render_mode": "rgb_array", "render_size": (160, 120), "num_cameras": 2}
    moments = []
    with small_race(**options) as env:
        for now in drive(env, 25):
            moments.append(now.snapshot.data)
            if len(moments) in (1, 20):
                picture, frames = now.render(), frames_of(now)
                assert is_picture(picture, (160, 120))
        assert env.render_backend == who_draws()
    assert moments == history(25)
    if who_draws() == "map":
        assert "the map is drawn instead" in caplog.text
        return
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 300
    assert (frames["kart_0"] != frames["kart_1"]).any()


@functools.cache
def drawn_by_the_game(size, cameras):
    """Returns the first frames of a race of five karts; only kart_0 is red."""
    agents = [AgentSpec(kart="tux"), *[AgentSpec(kart="puffy")] * 4]
    options = {"num_cameras": cameras, "render_mode": "rgb_array", "render_size": size}
    with race_v0.parallel_env(num_kart=5, agents=agents, track="hacienda", **options) as env:
        env.reset(seed=2)
        assert env.scene.kart_indices[0] != 0  # agents and karts have different numbers
        return frames_of(env)


def is_red(picture):
    red, green, blue = picture.transpose(2, 0, 1).astype(int)
    return (red > 2 * green) & (red > 2 * blue) & (red > 120)


@pytest.mark.slow
@pytest.mark.skipif(who_draws() == "map", reason="the game cannot draw on this machine")
def test_a_camera_is_behind_its_own_kart():
    frames = drawn_by_the_game((320, 240), 5)
    ahead = {agent: is_red(frame[140:200, 130:190]).sum() for agent, frame in frames.items()}
    assert ahead.pop("kart_0") > 400
    assert len(ahead) == 4
    assert max(ahead.values()) < 100


@pytest.mark.slow
@pytest.mark.skipif(who_draws() == "map", reason="the game cannot draw on this machine")
@pytest.mark.parametrize(
    ("size", "cameras"),
    marked([((320, 240), 5), ((1920, 1440), 1), ((1024, 768), 2)], kept=[((320, 240), 5)]),
)
def test_a_kart_has_the_same_shape_on_all_screens(size, cameras):
    """The game splits its screen; without a display, the screen is at most 1024 x 768."""
    one = shape_of_a_kart(drawn_by_the_game((320, 240), 1)["kart_0"])
    frame = drawn_by_the_game(size, cameras)["kart_0"]
    assert shape_of_a_kart(frame) == pytest.approx(one, rel=0.12)


def shape_of_a_kart(frame):
    """Returns the aspect ratio of the red kart in the frame of its own camera."""
    height, width, _ = frame.shape
    middle = frame[height // 2 :, width // 5 : -width // 5]
    rows, columns = np.nonzero(is_red(middle))
    sides = [np.diff(np.quantile(places, (0.01, 0.99)))[0] for places in (columns, rows)]
    return sides[0] / sides[1]


@pytest.mark.slow
@pytest.mark.skipif(who_draws() == "map", reason="the game cannot draw on this machine")
def test_drawn_karts_are_where_the_real_karts_are():
    errors = film_errors()
    assert np.median(errors) < 0.02
    assert np.quantile(errors, 0.9) < 0.2


def film_errors():
    """Returns the distances between drawn and real karts over 20 steps of a race [m]."""
    from stkzoo.render.game import GameView

    game, errors = GameView([0], SMALL), []
    with small_race() as env:
        for now in drive(env, 40):
            if now.scene is not None and not errors:
                game.start(now.scene)
            footage = game._go(now.snapshot, images=False)
            errors.append(
                np.linalg.norm(footage.locations - now.snapshot.karts["location"], axis=1)
            )
    game.close()
    return np.array(errors)[20:]


@pytest.mark.slow
@pytest.mark.skipif(who_draws() == "map", reason="the game cannot draw on this machine")
def test_a_render_process_that_died_is_an_error_and_the_race_continues():
    options = {"render_mode": "rgb_array", "render_backend": "engine", "render_size": SMALL}
    with small_race(**options) as env:
        steps = drive(env, 4)
        next(steps)
        env.render()
        os.kill(env.live_race.rendering._renderer._game._session.pid, signal.SIGKILL)
        with pytest.raises(EngineCrashed, match="the render process was ended by SIGKILL"):
            env.render()
        next(steps)
        assert is_picture(env.render())  # a new process draws


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it ends when it has drawn")
def test_a_program_that_dies_ends_its_render_process():
    code = """
import os, signal, threading, time
from pathlib import Path
from stkzoo import race_v0
options = {"render_mode": "rgb_array", "graphics_config": "hd"}  # half a minute, without a card
env = race_v0.parallel_env(num_kart=2, track="lighthouse", **options)
env.reset(seed=1)
def draws(pid):  # from then on, the kernel tells it when the program ends
    files = Path(f"/proc/{pid}/fdinfo").glob("*")
    texts = [file.read_text() for file in files if file.exists()]
    return any(int(text.split("flags:")[1].split()[0], 8) & os.O_ASYNC for text in texts)
def die():
    renderer = env.live_race.rendering._renderer
    while not (renderer.backend == "map" or (renderer._game and renderer._game._session.pid)):
        time.sleep(0.1)
    game = renderer._game
    print(game._session.pid if game else "map", flush=True)
    while game and not draws(game._session.pid):
        time.sleep(0.1)
    os.kill(os.getpid(), signal.SIGKILL)
threading.Thread(target=die).start()
while True:
    env.render()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    said = done.stdout.strip()
    assert said.isdigit() == (who_draws() == "engine")
    if said.isdigit():
        # much less time than drawing the frame takes
        assert wait_until(lambda: not Path(f"/proc/{said}").exists(), 5)


def test_missing_libraries_are_named_and_the_map_is_drawn(monkeypatch, caplog):
    monkeypatch.setattr(render_session.ctypes.util, "find_library", lambda _: None)
    monkeypatch.setattr(render_session.sys, "platform", "linux")
    with small_race(render_mode="rgb_array", render_size=SMALL) as env:
        env.reset(seed=1)
        assert is_picture(env.render())
        assert env.render_backend == "map"
    assert "sudo apt install libegl1" in caplog.text
    with small_race(render_mode="rgb_array", render_backend="engine") as env:
        env.reset(seed=1)
        with pytest.raises(ConfigError, match="libegl1"):
            env.render()
