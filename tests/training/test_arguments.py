"""Arguments shared by the training scripts."""

import math

import pytest

from stkzoo.agents.training.common.arguments import track_names
from stkzoo.agents.training.imitation.imitate import ImitationArguments
from stkzoo.agents.training.league.league import LeagueArguments
from stkzoo.agents.training.ppo.selfplay import SelfPlayArguments
from stkzoo.agents.training.sb3.selfplay import SB3Arguments, selfplay_setup
from stkzoo.errors import ConfigError
from stkzoo.tracks import TRAIN_ONLY_TRACKS, VALIDATION_TRACKS


def test_names_of_splits_are_replaced_with_their_tracks():
    assert track_names(["lighthouse", "validation"]) == ("lighthouse", *VALIDATION_TRACKS)


@pytest.mark.parametrize("kind", [ImitationArguments, LeagueArguments, SelfPlayArguments])
def test_training_excludes_the_validation_tracks(kind):
    assert kind(tracks=("train_only",)).tracks == TRAIN_ONLY_TRACKS


@pytest.mark.parametrize("kind", [ImitationArguments, SB3Arguments, SelfPlayArguments])
def test_an_unknown_track_is_refused_with_the_nearest_name(kind):
    with pytest.raises(ConfigError, match=r"unknown track 'lighthous'\. Did you mean 'lighthouse'"):
        kind(tracks=("lighthous",))


@pytest.mark.parametrize(
    ("kind", "given", "text"),
    [
        (SelfPlayArguments, {"learning_rate": math.nan}, "learning_rate is nan, .* above 0"),
        (SelfPlayArguments, {"gamma": 7.0}, "gamma is 7.0, .* from 0 to 1"),
        (SelfPlayArguments, {"kl_coef": -0.1}, "kl_coef is -0.1, .* of 0 or more"),
        (SelfPlayArguments, {"seed": 2**32}, "seed is 4294967296, .* from 0 to 4294967295"),
        (SelfPlayArguments, {"hidden": (8, 8, 8)}, r"hidden is \(8, 8, 8\), expected 2 layers"),
    ],
)
def test_numbers_out_of_bounds_are_refused(kind, given, text):
    with pytest.raises(ConfigError, match=text):
        kind(**given)


def test_coefficients_may_be_zero():
    assert SelfPlayArguments(kl_coef=0.0, ent_coef=0.0).kl_coef == 0


def test_a_single_step_is_too_few_to_learn_from():
    with pytest.raises(ConfigError, match="expected 2 or more steps"):
        selfplay_setup(SB3Arguments(n_steps=1, races="1"))
