"""Self-play with Stable-Baselines3: rivals, races and resuming after a kill."""

import json
import os
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest
from stable_baselines3 import PPO
from torch.nn.utils import parameters_to_vector

from stkzoo import Start
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.pretrained.action_filter import INPUT_MIRROR, INPUT_SIZE, ActionFilter
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.agents.training.common.arguments import Lineup, parse_races
from stkzoo.agents.training.evaluate import newest_policy
from stkzoo.agents.training.plot import main as plot_main
from stkzoo.agents.training.ppo.network import RacingNetwork, racing_weights
from stkzoo.agents.training.ppo.opponents import Matchmaker
from stkzoo.agents.training.sb3.selfplay import (
    SB3Arguments,
    SB3Run,
    SelfPlayRaces,
    main,
    selfplay_setup,
)
from stkzoo.errors import ConfigError
from stkzoo.sb3 import RaceVecEnv
from stkzoo.wrappers.racing import BRAKE, CHOICES, CONTEST_SIZE, PLACES, RESCUE, SIZE
from tests.support.training import last_policy, log_of, run_and_kill, words_of

SMALL = {
    "races": "2+1x1",
    "tracks": ("lighthouse",),
    "checkpoint_every": 2,
    "n_steps": 16,
    "batch_size": 32,
    "n_epochs": 2,
    "hidden": (16, 16),
    "keep_every": 60,
    "decay_timesteps": 100,
    "snapshot_share": 1.0,
}


def words(folder, until, **changes):
    return words_of(folder, SMALL | changes, total_timesteps=until)


def learn(folder, until, **changes):
    return main(words(folder, until, **changes))


def arrays_of(policy):
    """Returns the state dict of a policy as arrays."""
    return {name: value.numpy() for name, value in policy.state_dict().items()}


@pytest.fixture(scope="module")
def policy():
    """Returns an untrained policy."""
    envs = RaceVecEnv(1, num_kart=1, track="olivermath", view="racing")
    model = PPO("MlpPolicy", envs, policy_kwargs={"net_arch": [16, 16]}, device="cpu", seed=1)
    envs.close()
    return model.policy


# ---------------------------------------------------------------------- rivals


def test_a_full_pool_drops_the_most_beaten_rival():
    matchmaker = Matchmaker("prioritized", 2)
    matchmaker.add("first")
    matchmaker.add("second")
    assert [*matchmaker.pool] == ["first", "second"]
    matchmaker.update("second", 1.0)
    matchmaker.add("third")
    assert [*matchmaker.pool] == ["first", "third"]
    matchmaker.update("second", 1.0)  # the result of a race that was still running


# ---------------------------------------------------------------------- races


def test_groups_of_races_are_parsed():
    assert parse_races(["4x3", "2+1"]) == [Lineup(4, 0, 3), Lineup(2, 1, 1)]
    for text in ("many", "0x2", "2+-1", "2x0", "2x", ""):
        with pytest.raises(ConfigError, match="expected for example 4x3"):
            parse_races([text])


def races_of(arguments, matchmaker, folder, **options):
    """Returns races that all have the same options."""
    (group,) = selfplay_setup(arguments).groups
    envs = SelfPlayRaces(group, 11, matchmaker, Matchmaker(), folder)
    envs.races.set_options(options)
    return closing(envs)


@pytest.mark.slow
def test_past_selves_add_no_training_data(tmp_path, policy):
    save_weights(tmp_path / "past.safetensors", arrays_of(policy))
    matchmaker = Matchmaker("prioritized", share=1.0)
    matchmaker.add("past")
    arguments = SB3Arguments(races="4+1x2", tracks=("olivermath",))
    with races_of(arguments, matchmaker, tmp_path, max_cycles=12) as envs:
        envs.seed(5)
        envs.reset()
        for step in range(12):
            _, rewards, dones, infos = envs.step(np.zeros((8, 5), int))
            is_rival = dones & np.array([not info for info in infos])
            assert is_rival.reshape(2, 4).sum(axis=1).tolist() == [2, 2]
            assert not rewards[is_rival].any()
            assert dones[~is_rival].all() == (step == 11)
        assert [len(rewards) for rewards in envs.rewards] == [4] * 12
        assert [kart.ratio for kart in envs.finishes] == [None] * 4
        assert {1, 2, 3, 4, 5} >= {kart.position for kart in envs.finishes}
        assert matchmaker.pool["past"].races == 2
        assert {*matchmaker.reported} <= {0.0, 0.25, 0.5, 0.75, 1.0}


@pytest.mark.slow
def test_half_of_the_races_start_on_the_grid(tmp_path):
    (group,) = selfplay_setup(SB3Arguments(races="1x3", tracks=("olivermath",))).groups
    with closing(SelfPlayRaces(group, 11, Matchmaker(), Matchmaker(), tmp_path)) as envs:
        envs.seed(1)
        envs.reset()
        starts_anywhere = [bool(env.race.starts) for env in envs.races.races]
    assert starts_anywhere == [False, False, True]


@pytest.mark.slow
def test_half_of_the_races_are_on_tracks_where_the_learner_is_slow(tmp_path):
    tracks = ("lighthouse", "olivermath")
    setup = selfplay_setup(SB3Arguments(races="1x4", tracks=tracks, max_cycles=2))
    setup.tracks.pool["olivermath"].beaten = 1.0
    driven = []
    races = SelfPlayRaces(setup.groups[0], 11, Matchmaker(), setup.tracks, tmp_path)
    with closing(races) as envs:
        envs.seed(1)
        for _ in range(8):
            envs.reset()
            driven += [env.race.track for env in envs.races.races]
        for _ in range(2):
            envs.step(np.zeros((4, 5), int))
    assert driven.count("lighthouse") > 18  # of 32; a half and a quarter are expected
    assert driven.count("olivermath") > 0
    assert setup.tracks.pool["olivermath"].races + setup.tracks.pool["lighthouse"].races == 2


@pytest.mark.slow
def test_a_finish_is_a_truncation_for_the_learner(tmp_path):
    """The learner also gets the final observation and all rewards."""
    arguments = SB3Arguments(races="1x1", tracks=("lighthouse",))
    near_finish = Start(share=0.97, speed=15.0)
    with races_of(arguments, Matchmaker(), tmp_path, start=near_finish, reverse=False) as envs:
        envs.seed(1)
        envs.reset()
        total = 0.0
        while not envs.finishes:
            _, rewards, dones, infos = envs.step(np.array([[10, 0, 0, 0, 0]]))
            total += float(rewards[0])
        assert 0 < envs.finishes[0].ratio < 2
        assert dones[0]
        assert infos[0]["TimeLimit.truncated"]
        assert infos[0]["terminal_observation"][0:3].any()  # its velocity
        assert np.sum(envs.rewards) == pytest.approx(total)
        assert np.mean(envs.paces) == pytest.approx(1 / envs.finishes[0].ratio, rel=0.01)


# ---------------------------------------------------------------------- policies


RIGHT, LEFT = 15, 5  # 0.31 of the full steering angle


def views(*speeds, **parts):
    """Returns observations of karts with the given speeds [m/s]."""
    seen = np.zeros((len(speeds), SIZE), np.float32)
    seen[:, PLACES["velocity"].start + 2] = np.array(speeds) / 20.0
    seen[:, PLACES["skeed_factor"]] = 2.0  # they skid
    for part, number in parts.items():
        seen[:, PLACES[part].start] = number
    return seen


def drives(action_filter, steers, drifts):
    """Returns the filtered choices for one step's steering and drifting."""
    action_filter.look(views(*[20.0] * len(steers)))
    choices = np.zeros((len(steers), 5), int)
    choices[:, 0], choices[:, 2] = steers, drifts
    return action_filter.apply(choices)


def test_a_drift_is_held_from_its_start():
    action_filter = ActionFilter(2, 3)

    def down(*asked):
        return drives(action_filter, [RIGHT, LEFT], asked)[:, 2].tolist()

    assert down(1, 0) == [1, 0]
    assert down(0, 0) == [1, 0]
    assert down(0, 1) == [1, 1]
    assert down(0, 0) == [0, 1]
    action_filter.forget(slice(1, 2))
    assert down(0, 0) == [0, 0]


def test_the_memory_of_the_filter_is_observed():
    action_filter = ActionFilter(2, 11)
    for step in range(12):
        seen = action_filter.look(views(20.0, 20.0))
        assert seen.shape == (2, INPUT_SIZE)
        action_filter.apply(np.array([[RIGHT, 0, step > 0, 0, 0], [LEFT, 0, step > 0, 0, 0]]))
    ones, others = action_filter.look(views(20.0, 20.0))
    drifted = 11 / 30
    assert ones[SIZE + 2 : SIZE + 4].tolist() == pytest.approx([drifted, drifted])
    assert ones == pytest.approx(others * INPUT_MIRROR)
    fresh = ActionFilter(2, 11).look(views(0.0, 0.0))
    action_filter.forget(slice(0, 2))
    assert (action_filter.look(views(0.0, 0.0)) == fresh).all()


def test_a_stuck_kart_is_freed_but_not_on_the_grid():
    action_filter, choices = ActionFilter(2, 0), np.array([[10, 0, 0, 0, 0]] * 2)
    idle = ActionFilter(2, 0, recovers=False)
    pedals = []
    for step in range(60):
        for each in (action_filter, idle):
            each.look(views(0.0, 0.0 if step != 10 else 8.0, line_position=0.1))
        done = action_filter.apply(choices)
        assert (idle.apply(choices) == choices).all()
        pedals.append(done[:, 1].tolist())
    grid, stuck = np.array(pedals).T
    assert not grid.any()  # this kart has not moved yet
    called = np.flatnonzero(stuck == RESCUE)
    assert called[0] == 15
    backs = np.flatnonzero(stuck == BRAKE)
    assert backs[0] > called[0] + 14  # a rescue takes a while
    assert done[1, 0] in (0, 10)  # reverses away from the road's center on the right
    action_filter.forget(slice(0, 2))
    action_filter.look(views(0.0, 0.0))
    assert (action_filter.apply(choices) == choices).all()


def test_an_error_for_a_run_of_an_older_version_says_what_to_do(tmp_path):
    with closing(SB3Run(tmp_path, SB3Arguments(**SMALL))) as run:
        arguments = run._history[0]["arguments"]
        arguments["minibatch"] = arguments.pop("batch_size")
        run.save_checkpoint()
    with pytest.raises(ConfigError, match=r"another version of stkzoo.*give another --output"):
        SB3Run(tmp_path, SB3Arguments(**SMALL))


def test_a_driver_acts_like_its_policy(policy):
    seen = np.random.default_rng(0).normal(size=(64, SIZE)).astype(np.float32)
    driver = MlpDriver(arrays_of(policy))
    assert (driver.best(seen) == policy.predict(seen, deterministic=True)[0]).all()
    drawn = driver.sample(np.repeat(seen[:1], 4000, axis=0), np.random.default_rng(1))
    chances = policy.get_distribution(policy.obs_to_tensor(seen[:1])[0]).distribution
    for column, chance in enumerate(chances):
        shares = np.bincount(drawn[:, column], minlength=CHOICES[column]) / len(drawn)
        assert shares == pytest.approx(chance.probs[0].detach().numpy(), abs=0.05)


def test_initial_weights_can_lack_the_memory_of_the_filter(tmp_path):
    narrow = RacingNetwork((16, 16), seed=0).policy_weights()
    save_weights(tmp_path / "narrow", narrow)
    started = RacingNetwork((16, 16), seed=1, inputs=INPUT_SIZE)
    started.start_from(racing_weights(str(tmp_path / "narrow"), (16, 16)))
    seen = np.random.default_rng(0).normal(size=(64, INPUT_SIZE)).astype(np.float32)
    logits = MlpDriver(narrow).logits(seen[:, : INPUT_SIZE - MEMORY_SIZE])
    assert MlpDriver(started.policy_weights()).logits(seen) == pytest.approx(logits, abs=1e-5)


def test_incompatible_weights_are_refused(tmp_path):
    save_weights(tmp_path / "other", {"w0": np.zeros((3, 4), np.float32)})
    with pytest.raises(ConfigError, match="MlpPolicy from the 165 numbers"):
        racing_weights(str(tmp_path / "other"), (16, 16))
    save_weights(tmp_path / "narrow", RacingNetwork((8, 8), seed=0).policy_weights())
    with pytest.raises(ConfigError, match="--hidden"):
        racing_weights(str(tmp_path / "narrow"), (16, 16))
    contest = RacingNetwork((16, 16), seed=0, inputs=CONTEST_SIZE).policy_weights()
    save_weights(tmp_path / "contest", contest)
    with pytest.raises(ConfigError, match="for the view 'contest'"):
        racing_weights(str(tmp_path / "contest"), (16, 16))


# ---------------------------------------------------------------------- runs


@pytest.mark.slow
def test_values_are_learned_before_the_policy(tmp_path):
    with closing(SB3Run(tmp_path, SB3Arguments(**SMALL, warm_up=1_000_000))) as run:
        parts = run.network.policy, run.network.value
        first = [parameters_to_vector(part.parameters()).clone() for part in parts]
        run.iterate()
        last = [parameters_to_vector(part.parameters()) for part in parts]
    assert [bool((new == old).all()) for new, old in zip(last, first, strict=True)] == [True, False]


@pytest.mark.slow
def test_it_learns_and_ends(tmp_path):
    command = [sys.executable, "-m", "stkzoo.agents.training.sb3.selfplay"]
    command += words(tmp_path, 150)
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    log = log_of(tmp_path)
    assert log[-1]["kart_steps"] >= 150
    assert [line["iteration"] for line in log] == list(range(1, len(log) + 1))
    assert log[-1]["rivals"] >= 1
    assert 0 < log[0]["entropy"] <= sum(map(np.log, CHOICES))
    assert all(np.isfinite(list(line.values())).all() for line in log)
    seen = np.array([0, *(line["kart_steps"] for line in log[:-1])])
    rates = [line["learning_rate"] for line in log]
    assert np.allclose(rates, SB3Arguments().learning_rate / np.sqrt(1 + seen / 100), atol=1e-6)
    first = load_weights(min(tmp_path.glob("policy-*.safetensors")))
    assert any((last_policy(tmp_path)[name] != first[name]).any() for name in first)
    assert list(tmp_path.glob("events.out.tfevents.*"))
    assert (tmp_path / "agent" / "pystk_actor.py").exists()


@pytest.mark.matrix
@pytest.mark.skipif(os.name != "posix", reason="kills by signal")
def test_a_killed_run_resumes_as_if_uninterrupted(tmp_path):
    assert learn(tmp_path / "whole", 270) == 0
    killed = tmp_path / "killed"
    # Kill it during a round, with a rival in the pool.
    run_and_kill(main, words(killed, 100_000), killed / "log.jsonl", lines=5)
    assert learn(killed, 270) == 0
    assert log_of(killed) == log_of(tmp_path / "whole")
    assert log_of(killed)[-1]["rivals"] >= 2
    ours, theirs = last_policy(killed), last_policy(tmp_path / "whole")
    assert all((ours[name] == theirs[name]).all() for name in theirs)


@pytest.mark.matrix
def test_a_run_continues_after_races_without_rivals(tmp_path):
    alone = {"races": "1x2", "max_cycles": 12, "snapshot_share": 0.0}
    assert learn(tmp_path, 60, **alone) == 0
    assert "position" in log_of(tmp_path)[-1]  # some races have ended
    assert learn(tmp_path, 120, **alone) == 0
    assert log_of(tmp_path)[-1]["kart_steps"] >= 120


def test_a_run_starts_from_given_weights(tmp_path):
    with closing(SB3Run(tmp_path / "one", SB3Arguments(**SMALL))) as run:
        file = run.save_policy()
    with closing(SB3Run(tmp_path / "two", SB3Arguments(**SMALL, seed=7, init=str(file)))) as run:
        ours, theirs = run.network.policy_weights(), load_weights(file)
    assert all((ours[name] == theirs[name]).all() for name in theirs)


def test_the_newest_policy_of_a_run_is_the_one_with_which_it_ended(tmp_path):
    assert learn(tmp_path, 1) == 0
    file = max(tmp_path.glob("policy-*.safetensors"))
    assert newest_policy(str(tmp_path)) == str(file)
    newest, last = load_weights(file), load_weights(tmp_path / "policy.safetensors")
    assert all((newest[name] == last[name]).all() for name in last)


@pytest.mark.slow
def test_learning_curves_are_plotted(tmp_path):
    lines = [{"kart_steps": 1000 * n, "pace": 0.1 * n, "beaten": 0.5} for n in range(1, 5)]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))
    picture = tmp_path / "curves.png"
    assert plot_main([str(tmp_path), f"--output={picture}"]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert plot_main([str(tmp_path / "none"), f"--output={tmp_path / 'other.png'}"]) == 1
    assert not (tmp_path / "other.png").exists()
