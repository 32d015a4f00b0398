"""The parts of the RLlib script that need no Ray.

Ray wants an older Gymnasium than the rest of the tests, so it is not installed here.
``python -m benchmarks.rllib_cluster`` runs the whole script: docs/how-to/cluster.md.
"""

import importlib.util

import numpy as np
import pytest

from benchmarks.rllib_cluster import Trial
from stkzoo._installation import install_command
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.training.common.arguments import ScriptOptions
from stkzoo.agents.training.common.command import command_parser, run_command
from stkzoo.agents.training.rllib.races import (
    MAIN,
    RLlibArguments,
    ensure_assets,
    make_race,
    win_share,
)
from stkzoo.agents.training.rllib.selfplay import main, sb3_names
from stkzoo.engine.assets import find_assets
from stkzoo.errors import AssetError, ConfigError
from stkzoo.wrappers.racing import CHOICES, SIZE

POLICIES = RLlibArguments(learners=2, frozen=2, slots=3)


def test_the_first_karts_learn_and_past_selves_drive_the_others():
    assert POLICIES.modules == [MAIN, "past_0", "past_1", "past_2"]
    drawn = {POLICIES.module_of("kart_2", f"{number:x}") for number in range(50)}
    assert drawn == {"past_0", "past_1", "past_2"}
    assert {POLICIES.module_of("kart_1", f"{number:x}") for number in range(50)} == {MAIN}


def test_an_episodes_drivers_are_the_same_on_every_node():
    again = RLlibArguments(learners=2, frozen=2, slots=3)
    assert POLICIES.module_of("kart_3", "abc") == again.module_of("kart_3", "abc")


def test_a_new_snapshot_takes_the_oldest_ones_place():
    assert [POLICIES.slot(number) for number in range(5)] == [
        *("past_0", "past_1", "past_2"),
        *("past_0", "past_1"),
    ]


def test_without_past_selves_there_is_one_module():
    assert RLlibArguments(learners=4, frozen=0, slots=5).modules == [MAIN]


def test_the_share_of_pairs_won_counts_all_pairs():
    assert win_share({"kart_0": 1, "kart_1": 4, "kart_2": 2, "kart_3": 3}, POLICIES) == 0.5
    assert win_share({"kart_0": 1, "kart_2": 2}, POLICIES) == 1.0
    assert win_share({"kart_0": 1, "kart_1": 2}, POLICIES) is None


def test_races_are_made_as_asked():
    arguments = RLlibArguments(tracks=("lighthouse",), learners=2, frozen=1, bots=2, max_cycles=7)
    with make_race(arguments) as env:
        observations, _ = env.reset(seed=1)
        assert list(observations) == ["kart_0", "kart_1", "kart_2"]
        assert env.options.num_kart == 5
        assert env.race.track == "lighthouse"
        assert observations["kart_0"].shape == (SIZE,)
        steps = 0
        while env.agents:
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            steps += 1
        assert steps == 7


def test_nothing_is_installed_where_the_data_is():
    assert ensure_assets() is False


def test_a_node_without_the_data_that_nobody_sends_it_says_so(tmp_path, monkeypatch):
    empty = tmp_path / "cache"
    monkeypatch.setenv("STKZOO_CACHE", str(empty))
    monkeypatch.setenv("SUPERTUXKART_DATADIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    try:
        find_assets()
    except AssetError:
        with pytest.raises(AssetError, match="give --pack FILE"):
            ensure_assets()
        with pytest.raises(AssetError):
            ensure_assets(archive=str(tmp_path / "no.tar.xz"))
    else:
        assert ensure_assets() is False  # the game itself is installed on this system


def test_the_learned_weights_have_the_names_of_stable_baselines3():
    shapes = {
        "encoder.actor_encoder.net.mlp.0": (8, SIZE),
        "encoder.actor_encoder.net.mlp.2": (4, 8),
        "encoder.critic_encoder.net.mlp.0": (8, SIZE),
        "encoder.critic_encoder.net.mlp.2": (4, 8),
        "pi.net.mlp.0": (sum(CHOICES), 4),
        "vf.net.mlp.0": (1, 4),
    }
    state = {}
    for name, shape in shapes.items():
        state[f"{name}.weight"] = np.ones(shape, np.float32)
        state[f"{name}.bias"] = np.ones(shape[0], np.float32)
    weights = sb3_names(state)
    assert len(weights) == len(state)
    assert "mlp_extractor.value_net.2.bias" in weights
    assert MlpDriver(weights).best(np.zeros((1, SIZE), np.float32)).shape == (1, 5)


def test_the_command_line_is_read():
    words = ["--output", "run", "--track", "train", "--hidden", "64", "32"]
    found = []
    kinds = ScriptOptions, RLlibArguments
    run_command("rllib.selfplay", None, lambda *given: found.extend(given), kinds, words)
    options, arguments = found
    assert options.output.name == "run"
    assert arguments.hidden == (64, 32)
    assert len(arguments.tracks) == 15
    assert arguments.learners == 2


def test_the_trial_of_a_cluster_uses_options_that_exist(tmp_path):
    words = Trial(tmp_path, 10, 1.0, "some.tar.xz").words("auto")
    kinds = ScriptOptions, RLlibArguments
    assert command_parser("rllib.selfplay", "", kinds).parse_args(words).train_batch_size == 120


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--iterations", "0"], "iterations is 0"),
        (["--learners", "0"], "learners is 0"),
        (["--slots", "0"], "slots is 0"),
        (["--bots", "18"], "more than 20 karts"),
        (["--promote-at", "1.5"], "promote_at is 1.5"),
    ],
)
def test_bad_arguments_are_told(words, text, capsys):
    assert main(["--output", "run", *words]) == 1
    assert text in capsys.readouterr().err


@pytest.mark.skipif(importlib.util.find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_it_says_what_to_install(tmp_path, capsys):
    assert main(["--output", str(tmp_path / "run")]) == 1
    assert install_command("rllib") in capsys.readouterr().err


def test_past_selves_need_a_slot():
    with pytest.raises(ConfigError, match="frozen is -1"):
        RLlibArguments(frozen=-1)
