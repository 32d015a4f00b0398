"""The motion network learns from real races."""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.motion import LAYERS
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.agents.training import learn_motion
from tests.agents.planning.test_plan_viewer import planned, scene_arguments

pytest.importorskip("torch", reason="extra train")


@pytest.mark.matrix
def test_a_short_training_gives_a_network_that_plans_can_use(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(learn_motion, "_STEPS", 80)
    words = [f"--output={tmp_path}", "--rounds=1", "--n-epochs=3", "--hidden", "8", "6"]
    assert learn_motion.main(words) == 0
    weights = load_weights(tmp_path / "motion.safetensors")
    layers = tuple(weights[name] for name in LAYERS)
    shapes = [(8, 16), (8,), (6, 8), (6,), (3, 6), (3,)]
    assert [array.shape for array in layers] == shapes
    plans = planned(_planning.plan_karts, scene_arguments(0, count=2, motion=layers))
    assert np.isfinite(plans["best"]).all()
    assert "median" in capsys.readouterr().out


def test_the_gradient_finds_a_known_motion():
    random = np.random.default_rng(0)
    inputs = random.normal(size=(4000, 17)).astype(np.float32)
    truth = random.normal(0, 0.05, (3, 17)).astype(np.float32)
    truth[:, learn_motion._ODD] *= np.array([[1], [0], [1]])  # antisymmetric, as in a mirrored race
    truth[:, ~learn_motion._ODD] *= np.array([[0], [1], [0]])
    truth[:, -1] = 0
    outputs = inputs @ truth.T
    arguments = learn_motion.MotionArguments(n_epochs=30, batch_size=256, hidden=(32, 16))
    layers = learn_motion.fit(inputs, outputs, arguments)
    x = inputs[:, :-1]
    for matrix, bias in zip(layers[:-2:2], layers[1:-2:2], strict=True):
        x = np.maximum(x @ matrix.T + bias, 0)
    errors = x @ layers[-2].T + layers[-1] - outputs
    assert np.sqrt((errors**2).mean(axis=0) / (outputs**2).mean(axis=0)).max() < 0.2
