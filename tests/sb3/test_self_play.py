"""Self-play against past versions: the program in docs/how-to/opponents.md, and model pools."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from stable_baselines3 import A2C, PPO

from stkzoo import OpponentPool
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv
from tests.support.paths import ROOT

PROGRAM = ROOT / "examples" / "self_play.py"


def test_the_program_is_short_and_the_docs_show_all_of_it():
    assert len(PROGRAM.read_text().splitlines()) <= 40
    page = (ROOT / "docs" / "how-to" / "opponents.md").read_text("utf-8")
    assert "```{literalinclude} ../../examples/self_play.py\n" in page


def run_the_program(steps, matches):
    """Returns how many of how many duels the last policy won."""
    done = subprocess.run(
        [sys.executable, PROGRAM, "1", steps, matches],
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return map(int, re.search(r"won (\d+) of (\d+) duels", done.stdout).groups())


@pytest.mark.slow
def test_the_program_runs():
    run_the_program("256", "1")


@pytest.mark.matrix
def test_a_policy_beats_its_first_version_after_a_short_training():
    won, duels = run_the_program("16384", "6")
    assert 2 * won > duels


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", [PPO, A2C])
def test_a_pool_keeps_a_copy_of_a_model_that_continues_to_learn(algorithm):
    pool = OpponentPool(["random"])
    envs = RaceVecEnv(
        2, agents=1, num_kart=2, track="lighthouse", view="racing", max_cycles=8, opponents=pool
    )
    model = algorithm(
        "MlpPolicy", envs, n_steps=32, rollout_buffer_class=ActiveRolloutBuffer, device="cpu"
    )
    model.learn(64)
    seen = np.random.default_rng(0).normal(size=(64, *envs.observation_space.shape))
    kept = pool.add(model, name="kept").load(None).make_actor(envs.observation_space, None, 0)
    before, _ = model.predict(seen.astype(np.float32), deterministic=True)
    pool.weights["random"] = 0
    model.learn(64)
    assert {race.race.opponents for race in envs.races.races} == {("kept",)}
    assert (kept.policy.predict(seen.astype(np.float32), deterministic=True)[0] == before).all()
    weights = model.policy.action_net.weight.detach().numpy()
    assert (kept.policy.action_net.weight.detach().numpy() != weights).any()
    envs.close()
