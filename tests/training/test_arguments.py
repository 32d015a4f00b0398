"""Arguments shared by the training scripts."""

import pytest

from stkzoo.agents.training.common.arguments import track_names
from stkzoo.agents.training.imitation.distill import DistillationArguments
from stkzoo.agents.training.league.league import LeagueArguments
from stkzoo.agents.training.ppo.selfplay import SelfPlayArguments
from stkzoo.agents.training.sb3.curriculum import EASY_TO_HARD
from stkzoo.agents.training.sb3.selfplay import SB3Arguments
from stkzoo.agents.training.tune_plans import TuningArguments
from stkzoo.errors import ConfigError
from stkzoo.tracks import TRAIN_ONLY_TRACKS, VALIDATION_TRACKS


def test_names_of_splits_are_replaced_with_their_tracks():
    assert track_names(["lighthouse", "validation"]) == ("lighthouse", *VALIDATION_TRACKS)


@pytest.mark.parametrize(
    "kind", [DistillationArguments, LeagueArguments, SelfPlayArguments, TuningArguments]
)
def test_training_excludes_the_validation_tracks(kind):
    assert kind(tracks=("train_only",)).tracks == TRAIN_ONLY_TRACKS


@pytest.mark.parametrize("rate", [float("nan"), float("inf")])
def test_numbers_that_are_not_finite_are_refused(rate):
    with pytest.raises(ConfigError, match=f"learning_rate is {rate}, expected a finite number"):
        SelfPlayArguments(learning_rate=rate)


def test_a_curriculum_over_a_split_is_sorted_from_easy_to_hard():
    tracks = SB3Arguments(tracks=("train_only",)).tracks
    assert tracks == tuple(t for t in EASY_TO_HARD if t not in VALIDATION_TRACKS)


def test_a_curriculum_keeps_the_given_order_of_tracks():
    assert SB3Arguments(tracks=("minigolf", "lighthouse")).tracks == ("minigolf", "lighthouse")
