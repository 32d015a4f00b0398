"""Where agents start, and which agents the game's window follows."""

import numpy as np
import pytest

from stkzoo import AgentSpec, CameraMode, race_v0
from stkzoo.env.grid import draw_race
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError


def draw(agents, num_kart=4, num_cameras=0, has_window=False, seed=0):
    options = RaceOptions(num_kart=num_kart)
    random = np.random.default_rng(seed)
    return draw_race(options, agents, ["lighthouse"], num_cameras, has_window, random)


def cameras(agents, **options):
    setup, kart_indices = draw(agents, **options)
    return [CameraMode(setup.karts[index].camera_mode) for index in kart_indices]


def test_chosen_places_are_kept_and_free_ones_are_drawn():
    agents = [AgentSpec(rank_start=2), AgentSpec(), AgentSpec(rank_start=0)]
    places = {draw(agents, seed=seed)[1] for seed in range(20)}
    assert places == {(2, 1, 0), (2, 3, 0)}


def test_every_kart_has_a_setup_and_bots_fill_the_grid():
    setup, kart_indices = draw([AgentSpec(name="me"), AgentSpec(use_ai=True)])
    assert len(setup.karts) == 4
    assert [setup.karts[index].is_bot for index in kart_indices] == [False, True]
    assert sum(kart.is_bot for kart in setup.karts) == 3


AI, PLAYER, SHOWN = AgentSpec(use_ai=True), AgentSpec(), AgentSpec(camera_mode=CameraMode.ON)
OFF, ON = CameraMode.AUTO, CameraMode.ON


@pytest.mark.parametrize(
    ("agents", "num_cameras", "expected"),
    [
        ([AI, PLAYER, PLAYER], 0, [OFF, ON, ON]),  # those that the AI does not drive
        ([AI, AI], 0, [ON, OFF]),  # one, even if the AI drives all
        ([PLAYER, SHOWN], 0, [OFF, ON]),  # explicit choices
        ([PLAYER, PLAYER], 1, [OFF, OFF]),
    ],
)
def test_the_window_follows_agents(agents, num_cameras, expected):
    assert cameras(agents, has_window=True, num_cameras=num_cameras) == expected


def test_the_window_shows_at_most_eight_agents():
    shown = cameras([AgentSpec() for _ in range(12)], num_kart=12, has_window=True)
    assert shown.count(CameraMode.ON) == 8


def test_agent_specs_may_be_changed_until_the_next_reset():
    spec = AgentSpec()
    with race_v0.parallel_env(agents=[spec], num_kart=2, track="olivermath") as env:
        spec.kart, spec.rank_start = "gnu", 1
        env.reset(seed=0)
        assert env.race.kart_types == ("tux", "gnu")
        spec.use_ai = True
        with pytest.raises(ConfigError, match="make a new environment"):
            env.reset()


def test_the_direction_of_a_race_is_reported():
    with race_v0.parallel_env(num_kart=2, track="lighthouse", reverse=None, max_paths=1) as env:
        env.reset(seed=1)
        directions = [env.race.reverse]
        env.reset(options={"reverse": not directions[0]})
        assert env.race.reverse is not directions[0]
        while len(set(directions)) < 2:
            env.reset()
            directions.append(env.race.reverse)
