"""The plans as a view of users' environments: one agent, and all karts of many races."""

from contextlib import closing

import numpy as np
import pytest

from stkzoo import RaceVectorEnv, race_v0
from stkzoo.agents.planning.driver import likeliest, mirrored_inputs
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.view import PlanChoices, PlanVectorEnv, surroundings_view
from stkzoo.errors import ConfigError

RACES = {"num_kart": 3, "agents": 2, "track": "olivermath", "num_starts": 1, "start_seed": 1}


@pytest.mark.slow
def test_all_karts_at_once_get_the_values_of_one_agent():
    """The two forms round differently, so the races drift apart slowly."""
    together = PlanVectorEnv(2, **RACES)
    singly = RaceVectorEnv(2, view=PlanChoices, **RACES)
    with closing(together), closing(singly):
        ours, _ = together.reset(seed=3)
        theirs, _ = singly.reset(seed=3)
        assert together.observation_space.contains(ours)
        for step in range(60):
            for key in ours:
                np.testing.assert_allclose(ours[key], theirs[key], atol=2e-3, rtol=1e-3)
            choices = likeliest(ours["prior"])
            ours, _, _, _, infos = together.step(choices)
            theirs, *_ = singly.step(choices)
            assert infos["applies"].all() == (step >= 20)  # after the countdown


def test_races_that_end_report_the_last_observation_and_begin_again():
    with closing(PlanVectorEnv(1, skip_countdown=True, max_cycles=5, **RACES)) as races:
        first, _ = races.reset(seed=1)
        observations = first
        for _ in range(5):
            observations, _, _, cut, infos = races.step(likeliest(observations["prior"]))
        assert cut.all()
        assert (infos["final_obs"][0]["inputs"] != observations["inputs"][0]).any()
        np.testing.assert_array_equal(observations["inputs"], first["inputs"])


def test_mirrored_karts_observe_and_act_with_left_and_right_swapped():
    plain = PlanVectorEnv(1, skip_countdown=True, **RACES)
    mirrored = PlanVectorEnv(1, skip_countdown=True, mirror_share=1.0, **RACES)
    with closing(plain), closing(mirrored):
        ours, _ = plain.reset(seed=1)
        theirs, _ = mirrored.reset(seed=1)
        for _ in range(30):
            np.testing.assert_allclose(mirrored_inputs(theirs["inputs"]), ours["inputs"], atol=1e-6)
            ours, *_ = plain.step(likeliest(ours["prior"]))
            theirs, *_ = mirrored.step(likeliest(theirs["prior"]))


@pytest.mark.slow
def test_plans_on_the_racing_line_see_it():
    parameters = DriverParameters(racing_line=True)
    with closing(PlanVectorEnv(1, parameters=parameters, skip_countdown=True, **RACES)) as races:
        observations, _ = races.reset(seed=1)
        for _ in range(50):
            observations, *_ = races.step(likeliest(observations["prior"]))
        assert (races.races.races[0].snapshot.karts["overall_distance"] > 30).all()


def test_other_views_are_refused():
    with pytest.raises(ConfigError, match="plans need the view 'full' or 'ground'"):
        RaceVectorEnv(1, view=lambda env: PlanChoices(_racing(env)), num_kart=1)


def _racing(env):
    from stkzoo.views import find_view

    return find_view("racing")(env)


@pytest.mark.slow
def test_the_nearest_items_are_observed_on_a_track_with_more():
    race = {"num_kart": 2, "agents": 1, "track": "black_forest"}
    with closing(race_v0.parallel_env(view="full", **race)) as env:
        seen = env.reset(seed=1)[0]["kart_0"]
    distances = np.sort(np.linalg.norm(seen["items_position"], axis=1))
    assert len(distances) > 64
    with closing(race_v0.parallel_env(view=surroundings_view(sees_line=False), **race)) as env:
        seen = env.reset(seed=1)[0]["kart_0"]
    assert np.sort(np.linalg.norm(seen["items"], axis=1)) == pytest.approx(distances[:64])
