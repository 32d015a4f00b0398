"""Driving with the keyboard: Gymnasium's ``play()``, ``stkzoo play`` and recordings.

Keys are synthetic events. Without a display, SDL's dummy driver receives them.
"""

import os
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest

import stkzoo
from stkzoo._installation import install_command
from stkzoo.cli import main
from stkzoo.env.keyboard import KEYS, base_action
from stkzoo.errors import ConfigError
from stkzoo.evaluation import load_demonstrations
from stkzoo.play import play_race
from stkzoo.race import RaceListener
from stkzoo.views import VIEWS

pygame = pytest.importorskip("pygame")

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # without a display, Gymnasium warns that it cannot plot
    from gymnasium.utils import play as gym_play

CODES = {key.name: key.code for key in KEYS}
UP, DOWN, LEFT, RIGHT = (CODES[name] for name in ("up", "down", "left", "right"))
SMALL = {"render_mode": "rgb_array", "render_backend": "map", "render_size": (160, 120)}


@pytest.fixture(autouse=True)
def dummy_screen(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.quit()


class Fingers:
    """Presses and releases keys."""

    def __init__(self):
        self.down = set()

    def hold(self, *keys):
        for key in sorted(set(keys) - self.down):
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
        for key in sorted(self.down - set(keys)):
            pygame.event.post(pygame.event.Event(pygame.KEYUP, key=key))
        self.down = set(keys)

    def follow(self, ahead):
        """Drives at full throttle and steers towards ``(x, y, z)`` in the kart's frame."""
        angle = np.arctan2(ahead[0], ahead[2])
        self.hold(UP, *([RIGHT] if angle > 0.06 else [LEFT] if angle < -0.06 else []))


def press(key):
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    pygame.event.post(pygame.event.Event(pygame.KEYUP, key=key))


def leave():
    pygame.event.post(pygame.event.Event(pygame.QUIT))


def make(view, **options):
    return gym.make(f"supertuxkart/{view}-v0", track="lighthouse", **SMALL, **options)


# ------------------------------------------------------------------ Gymnasium's play()


def test_key_codes_match_pygame():
    pygame.init()
    assert {key.name: key.code for key in KEYS} == {
        name: pygame.key.key_code(name) for name in CODES
    }


@pytest.mark.parametrize("view", VIEWS)
def test_every_combination_of_keys_is_an_action_of_the_view(view):
    env = make(view, num_kart=2)
    actions = env.unwrapped.get_keys_to_action()
    assert len(actions) == 2 ** len(KEYS)
    assert all(action in env.action_space for action in actions.values())
    env.close()


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ([], {}),
        ([UP], {"acceleration": 1}),
        ([UP, LEFT], {"acceleration": 1, "steer": -1}),
        ([UP, RIGHT, CODES["v"]], {"acceleration": 1, "steer": 1, "drift": 1}),
        ([UP, DOWN], {"brake": 1}),
        ([LEFT, RIGHT], {}),
        ([CODES["space"], CODES["n"], CODES["backspace"]], {"fire": 1, "nitro": 1, "rescue": 1}),
    ],
)
def test_keys_give_the_documented_actions(keys, expected):
    action = {name: float(np.ravel(value)[0]) for name, value in base_action(keys).items()}
    assert action == {**dict.fromkeys(action, 0.0), **expected}


@pytest.mark.parametrize("view", ["control", "flattened_control"])
def test_the_keys_drive_and_steer_in_physical_units(view):
    velocities = []
    for turn in (LEFT, RIGHT):
        env = make(view, num_kart=1)
        env.reset(seed=1)
        actions = env.unwrapped.get_keys_to_action()
        for keys in [(UP,)] * 50 + [tuple(sorted((UP, turn)))] * 5:
            env.step(actions[keys])
        kart = env.unwrapped.core.snapshot.karts[0]
        velocities.append((float(kart["speed"]), kart["front"] - kart["location"]))
        env.close()
    (left_speed, left), (right_speed, right) = velocities
    assert min(left_speed, right_speed) > 5
    assert np.cross(left, right)[1] > 0.05


def test_a_view_without_a_meaning_for_keys_is_refused():
    stkzoo.register_view(
        "keyless",
        lambda env: gym.wrappers.TransformAction(
            gym.wrappers.FilterObservation(VIEWS["simple"](env), ["velocity"]), lambda a: a, None
        ),
    )
    try:
        with pytest.raises(ConfigError, match="'keyless' has no default keys"):
            make("keyless").unwrapped.get_keys_to_action()
    finally:
        del VIEWS["keyless"], gym.registry["supertuxkart/keyless-v0"]


@pytest.mark.slow
def test_play_with_keys_from_observations_finishes_a_lap():
    fingers, ends = Fingers(), []
    env = make("full", num_kart=2)

    def look(_, seen, action, reward, terminated, truncated, info):
        assert action in env.action_space
        fingers.follow(seen["paths_end"][2])
        if terminated or truncated:
            ends.append((terminated, info["finish_time"], reward))
            leave()

    gym_play.play(env, fps=100_000, callback=look, seed=1)
    env.close()
    ((finished, seconds, reward),) = ends
    assert finished
    assert 20 < seconds < 100
    assert reward > 5


# ------------------------------------------------------------------ stkzoo play


class Driving(RaceListener):
    """Drives with keys, and calls functions at given steps."""

    def __init__(self, **at):
        self.fingers, self.at, self.steps = Fingers(), at, 0

    def stepped(self, race):
        self.steps = race.steps
        if "kart_0" in race.observations:
            self.fingers.follow(race.observations["kart_0"]["paths_end"][2])
        if (todo := self.at.get(f"step_{race.steps}")) is not None:
            todo()


WINDOW = {"backend": "map", "size": (160, 120), "track": "lighthouse", "seed": 3}


@pytest.mark.slow
def test_the_user_drives_the_first_kart():
    result = play_race(["ai", "random"], rate=60, max_steps=90, listeners=[Driving()], **WINDOW)
    assert [agent.driver for agent in sorted(result.agents, key=lambda a: a.agent)] == [
        "you",
        "ai",
        "random",
    ]
    assert result.wall_time >= 1.4  # in real time, 90 steps of 1/60 s take 1.5 s


@pytest.mark.parametrize(
    "leaving", [lambda: press(pygame.K_ESCAPE), leave], ids=["escape", "closed window"]
)
def test_leaving_ends_the_race(leaving):
    driving = Driving(step_5=leaving)
    result = play_race([], rate=20, listeners=[driving], **WINDOW)
    assert result.status == "left"
    assert driving.steps == 6


@pytest.mark.slow
def test_a_pause_lasts_until_the_key_is_pressed_again():
    import threading

    goes_on = threading.Timer(1.0, lambda: press(pygame.K_p))

    def pause():
        press(pygame.K_p)
        goes_on.start()

    driving = Driving(step_5=pause)
    result = play_race([], rate=60, max_steps=10, listeners=[driving], **WINDOW)
    goes_on.join()
    assert result.status == "max_steps"
    assert result.wall_time > 0.5


def test_keys_are_released_when_the_window_loses_the_focus():
    from stkzoo.play import PlayScreen

    screen = PlayScreen((160, 120))
    fingers = Fingers()
    fingers.hold(UP, LEFT)
    screen.listen()
    assert screen.pressed == {UP, LEFT}
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    screen.listen()
    assert screen.pressed == set()
    screen.close()


@pytest.mark.slow
def test_a_recorded_dataset_repeats_the_same_race(tmp_path):
    path = tmp_path / "me.safetensors"
    play_race(
        [],
        rate=10,
        view="flattened_discrete",
        dataset=str(path),
        max_steps=45,
        listeners=[Driving()],
        **WINDOW,
    )
    (episode,) = demos = load_demonstrations(path)
    about, data = demos.plan, demos.columns
    env = gym.make(
        about["env_id"],
        num_kart=about["num_kart"],
        track=episode.facts.track,
        step_size=about["step_size"],
        reward="race",
    )
    observation, _ = env.reset(seed=episode.facts.seed)
    seen, rewards = [observation["continuous"]], []
    for action in data["actions"]:
        observation, reward, *_ = env.step(action)
        seen.append(observation["continuous"])
        rewards.append(reward)
    env.close()
    assert len(set(data["actions"].tolist())) > 1
    # The compiled kernel rounds differently.
    np.testing.assert_allclose(data["observations/continuous"], seen, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(data["rewards"], rewards)
    assert (len(episode), episode.is_finished) == (45, False)


def test_dict_actions_are_recorded_as_one_array_per_entry(tmp_path):
    path = tmp_path / "me.safetensors"
    play_race([], rate=60, view="simple", dataset=str(path), max_steps=5, **WINDOW)
    data = load_demonstrations(path).columns
    assert data["actions/acceleration"].shape == (5, 1)
    assert data["actions/brake"].dtype == np.int64
    assert data["observations/paths_end"].shape == (6, 5, 3)
    assert data["observations/kart_type"].shape == (6,)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"rate": 25}, "rate is 25, expected one of 10, 12"),
        ({"dataset": "nowhere/me.safetensors"}, "there is no folder"),
        ({"dataset": "me.safetensors", "view": "full"}, "differ in size"),
    ],
)
def test_invalid_options_are_refused(options, match):
    with pytest.raises(ConfigError, match=match):
        play_race([], **{**WINDOW, **options})


def test_without_a_display_it_says_what_to_do(monkeypatch):
    for name in ("SDL_VIDEODRIVER", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(ConfigError, match="start a desktop session, or use `xvfb-run`"):
        play_race([], **WINDOW)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_a_display_that_does_not_answer_is_refused(monkeypatch):
    for name in ("SDL_VIDEODRIVER", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("DISPLAY", "127.0.0.1:59999")
    with pytest.raises(ConfigError, match="WAYLAND_DISPLAY names does not answer"):
        play_race([], max_steps=1, **WINDOW)


def test_a_recording_is_not_replaced_by_the_next_one(tmp_path):
    path = tmp_path / "me.safetensors"
    path.write_bytes(b"a recording")
    with pytest.raises(
        ConfigError, match=r"me\.safetensors' exists; choose another name, or delete it"
    ):
        play_race([], dataset=str(path), view="simple", max_steps=1, **WINDOW)
    assert path.read_bytes() == b"a recording"


def test_without_pygame_it_names_the_extra():
    code = (
        "import sys; sys.modules['pygame'] = None\n"
        "from stkzoo.play import play_race\n"
        "play_race([], backend='map')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert install_command("races") in done.stderr
    assert "ConfigError" in done.stderr


@pytest.mark.slow
def test_the_command_plays_and_records(tmp_path, capsys):
    arguments = ["play", "ai", "--track", "lighthouse", "--seed", "1", "--map", "--max-steps", "8"]
    window = ["--width", "160", "--height", "120"]
    files = ["--dataset", str(tmp_path / "me.safetensors"), "--replay", str(tmp_path / "me.stkz")]
    assert main([*arguments, *window, *files]) == 0
    assert "Ended after 8 steps, countdown included" in capsys.readouterr().out
    assert sorted(os.listdir(tmp_path)) == ["me.safetensors", "me.stkz"]
    assert main(["replay", str(tmp_path / "me.stkz")]) == 0


@pytest.mark.parametrize(
    ("flags", "match"),
    [
        (["--view", "simple"], "give --dataset too"),
        (["--map", "--3d"], "not allowed with"),
    ],
)
def test_bad_flags_are_reported(flags, match, capsys):
    assert main(["play", *flags]) == 2
    assert match in capsys.readouterr().err
