"""The files of a run can be continued after crashes, and belong to one program at a time."""

import importlib
import json
from pathlib import Path

import pytest

from stkzoo._locks import locked_folder
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training.common.arguments import RunArguments
from stkzoo.agents.training.common.run_folder import (
    CHECKPOINT,
    LOG,
    TrainingLog,
    keep_arguments,
    read_log,
    save_checkpoint,
)
from stkzoo.agents.training.sb3 import selfplay as sb3
from stkzoo.agents.training.suite import algorithms
from stkzoo.errors import ConfigError


def write_iterations(folder, count, rest=""):
    lines = [json.dumps({"iteration": n, "kart_steps": 10 * n}) + "\n" for n in range(1, count + 1)]
    (folder / LOG).write_text("".join(lines) + rest)


def test_a_run_continues_after_an_incomplete_line_of_its_log(tmp_path):
    write_iterations(tmp_path, 2, '{"iteration": 3, "kart')
    with TrainingLog(tmp_path, 2) as log:
        assert log.last["iteration"] == 2
        log.write({"iteration": 3, "kart_steps": 30})
    assert [line["iteration"] for line in read_log(tmp_path)] == [1, 2, 3]


def test_a_checkpoint_and_weights_that_cannot_be_written_are_errors(tmp_path):
    for file in (CHECKPOINT, "weights"):
        (tmp_path / file).mkdir()
    with pytest.raises(ConfigError, match=r"the checkpoint .* cannot be written: .* not a regular"):
        save_checkpoint(tmp_path, {}, {})
    with pytest.raises(ConfigError, match=r"the weights .* cannot be written: .* not a regular"):
        save_weights(tmp_path / "weights", {})


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_log_on_a_full_disk_is_an_error(tmp_path):
    with TrainingLog(tmp_path, 0) as log:
        (tmp_path / LOG).unlink()
        (tmp_path / LOG).symlink_to("/dev/full")
        with pytest.raises(ConfigError, match=r"the log .* cannot be written: No space left"):
            log.write({"iteration": 1, "kart_steps": 10})


def test_a_damaged_line_within_a_log_is_reported(tmp_path):
    write_iterations(tmp_path, 2, '{"iteration": 3, "kart\n')
    with pytest.raises(ConfigError, match="in line 3: Input data was truncated"):
        TrainingLog(tmp_path, 2)


def test_figures_that_are_not_finite_are_logged_as_null(tmp_path):
    with TrainingLog(tmp_path, 0) as log:
        log.write({"iteration": 1, "kart_steps": 10, "kl": float("nan"), "loss": float("-inf")})
    with TrainingLog(tmp_path, 1) as log:
        assert log.last == {"iteration": 1, "kart_steps": 10, "kl": None, "loss": None}


def test_a_run_that_ended_at_once_can_have_other_arguments(tmp_path):
    with locked_folder(tmp_path, "run"):
        keep_arguments(tmp_path, RunArguments(seed=1))
        keep_arguments(tmp_path, RunArguments(seed=2))
        write_iterations(tmp_path, 1)
        with pytest.raises(ConfigError, match="seed was 2, now 3"):
            keep_arguments(tmp_path, RunArguments(seed=3))


def test_an_unreadable_file_of_weights_does_not_bind_a_run_to_its_name(tmp_path, capsys):
    folder = tmp_path / "run"
    words = [f"--output={folder}", "--races=1x1", "--total-timesteps=0"]
    assert sb3.main([*words, "--init=misspelt.safetensors"]) == 1
    assert "cannot be read" in capsys.readouterr().err
    assert sb3.main(words) == 0


#: Training commands, with the options that they require.
COMMANDS = {
    "ppo.selfplay": ["--total-timesteps=1"],
    "league.league": [],
    "sb3.selfplay": [],
    "rllib.selfplay": [],
    "imitation.imitate": [],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_two_programs_cannot_train_in_one_folder(name, tmp_path, capsys):
    if name.startswith("rllib"):
        pytest.importorskip("ray.rllib")
    command = importlib.import_module(f"stkzoo.agents.training.{name}")
    with locked_folder(tmp_path, "run"):
        assert command.main([f"--output={tmp_path}", *COMMANDS[name]]) == 1
    assert "another program works on" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["lock"]


def test_two_programs_cannot_train_a_reference_algorithm_in_one_folder(tmp_path):
    with locked_folder(tmp_path, "run"), pytest.raises(ConfigError, match="another program works"):
        algorithms.run("ippo", tmp_path, "solo-general", 1, 0)
