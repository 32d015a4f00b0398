"""Demonstrations: recorded observations and actions."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load_file

from stkzoo import AgentSpec, race_v0
from stkzoo.cli import main
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.evaluation import (
    DemoRecorder,
    DemoView,
    load_demonstrations,
    record_demonstrations,
    save_demonstrations,
)
from stkzoo.race import run_race
from stkzoo.race.replay import recorded_driver
from stkzoo.wrappers.racing import SIZE, controls_of_choices

SHORT = {"tracks": "lighthouse", "karts": 2, "max_steps": 60, "jobs": 1}


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Records two short races of an agent against the game's AI."""
    file = tmp_path_factory.mktemp("demos") / "driven.safetensors"
    return file, record_demonstrations("pursuit", output=file, seeds=(3, 4), rivals=["ai"], **SHORT)


@pytest.mark.slow
def test_a_data_set_has_observations_and_actions(driven):
    _, demos = driven
    assert len(demos) == 4
    assert demos.lengths.tolist() == [60] * 4
    observations, actions = demos.pairs()
    assert observations.shape == (240, SIZE)
    assert observations.dtype == np.float32
    assert actions.shape == (240, 5)
    episode = demos[2]
    assert len(episode) == 60
    assert episode.observations.shape == (61, SIZE)
    assert episode.controls.shape == (60, len(CONTROLS))
    np.testing.assert_array_equal(episode.observations[:-1], observations[120:180])
    np.testing.assert_array_equal(episode.actions, actions[120:180])
    assert (episode.facts.race, episode.facts.agent, episode.facts.seed) == (1, "kart_0", 4)
    assert not episode.is_finished


@pytest.mark.slow
def test_a_data_set_records_how_it_was_made(driven):
    file, _ = driven
    plan = load_demonstrations(file).plan
    assert plan["agents"][0]["source"] == "pursuit"
    assert (plan["view"], plan["tracks"], plan["seeds"]) == ("racing", ["lighthouse"], [3, 4])
    assert plan["rivals"] == ["ai"]
    assert plan["versions"]["pystk2"]


@pytest.mark.slow
def test_a_file_survives_loading(driven):
    file, demos = driven
    names = set(load_file(file))
    assert names == {"observations", "actions", "controls", "rewards", "lengths"}
    again = load_demonstrations(file)
    assert again.facts == demos.facts
    for name, column in demos.columns.items():
        np.testing.assert_array_equal(again.columns[name], column)


@pytest.mark.slow
def test_recorded_controls_reproduce_the_race(driven):
    _, demos = driven
    drivers = [recorded_driver("again", demos[number].controls) for number in (0, 1)]
    recorder = DemoRecorder(2, DemoView("racing"))
    how = {"track": "lighthouse", "seed": 3, "max_steps": 60, "wait_for": (0, 1)}
    run_race([*drivers, "ai"], listeners=[recorder], **how)
    again = recorder.episodes(demos.plan).columns["observations"]
    np.testing.assert_array_equal(again, demos.columns["observations"][: 2 * 61])


def test_recorded_actions_are_the_nearest_to_the_controls(driven):
    _, demos = driven
    as_told = controls_of_choices(demos.columns["actions"])
    controls = demos.columns["controls"]
    buttons = [CONTROLS.index(name) for name in ("drift", "fire", "nitro")]
    np.testing.assert_array_equal(as_told[:, buttons], controls[:, buttons])
    assert np.abs(as_told[:, 1] - controls[:, 1]).max() <= 0.1


@pytest.mark.slow
def test_the_ais_action_covers_its_controls_until_the_next_observation():
    """Compares with an environment that takes steps of a quarter of the length."""
    recorder = DemoRecorder(1, DemoView("racing"), substeps=4)
    run_race(["ai", "ai"], listeners=[recorder], track="lighthouse", seed=5, max_steps=240)
    episode = recorder.episodes({"view": "racing"})[0]
    observations, controls = [], []
    for observation in ai_race(step_size=0.1 / 4, steps=240):
        observations.append(observation)
        action = observation["action"]
        controls.append([np.ravel(action[name])[0] for name in CONTROLS])
    quarters = np.array(controls[1:]).reshape(60, 4, 7)
    np.testing.assert_allclose(episode.controls[:, :2], quarters.mean(axis=1)[:, :2], atol=1e-6)
    np.testing.assert_array_equal(episode.controls[:, 4], quarters[:, :, 4].any(axis=1))
    assert np.ptp(quarters[:, :, 1], axis=1).max() > 0.1  # it acts more often than observed
    seen = [DemoView("racing").observe(observation) for observation in observations[::4]]
    np.testing.assert_array_equal(episode.observations, np.array(seen))


def ai_race(step_size, steps):
    """Returns the observations of an agent that the game's AI drives."""
    with race_v0.parallel_env(
        agents=[AgentSpec(use_ai=True, color=number / 2) for number in range(2)],
        num_kart=2,
        track="lighthouse",
        step_size=step_size,
        max_cycles=None,
    ) as env:
        observations, _ = env.reset(seed=5)
        yield observations["kart_0"]
        for _ in range(steps):
            observations, *_ = env.step({})
            yield observations["kart_0"]


@pytest.mark.slow
def test_races_of_the_ai_end_at_the_finish(tmp_path):
    how = {"tracks": "lighthouse", "karts": 2, "difficulty": 3, "jobs": 1}
    whole = record_demonstrations("ai", output=tmp_path / "d.safetensors", **how)
    assert all(episode.is_finished for episode in whole)
    assert {episode.facts.rank for episode in whole} == {1, 2}
    assert all(0 < episode.facts.finish_time < 60 for episode in whole)


@pytest.mark.slow
@pytest.mark.parametrize("view", ["flattened_discrete", "box_continuous"])
def test_other_views_are_recorded_in_their_own_spaces(view, tmp_path):
    how = {**SHORT, "karts": 1, "max_steps": 25}
    demos = record_demonstrations("pursuit", output=tmp_path / "d.safetensors", view=view, **how)
    spaces = DemoView(view)
    episode = load_demonstrations(tmp_path / "d.safetensors")[0]
    assert all(action in spaces.action_space for action in episode.actions)
    if view == "flattened_discrete":
        assert set(episode.observations) == set(spaces.observation_space)
    else:
        assert all(seen in spaces.observation_space for seen in episode.observations)
    assert demos.num_steps == 25


@pytest.mark.slow
def test_other_demonstrations_are_not_overwritten(driven):
    file, _ = driven
    with pytest.raises(ConfigError, match=r"other demonstrations.*seeds is"):
        record_demonstrations("pursuit", output=file, seeds=5, rivals=["ai"], **SHORT)


COMMAND = ["pursuit", "--track", "lighthouse", "--karts", "1", "--max-steps", "40", "--jobs", "1"]


@pytest.mark.slow
def test_recording_resumes_after_an_interruption(driven, tmp_path):
    def stop(progress):
        if progress.done == 1:
            raise KeyboardInterrupt

    file = tmp_path / "d.safetensors"
    how = {**SHORT, "seeds": (3, 4), "rivals": ["ai"]}
    with pytest.raises(KeyboardInterrupt):
        record_demonstrations("pursuit", output=file, on_race=stop, **how)
    (kept,) = (tmp_path / "d.safetensors.parts" / "races").glob("*.safetensors")
    notes = kept.parent.with_name("notes.txt")
    notes.write_text("mine")
    heard = []
    demos = record_demonstrations("pursuit", output=file, on_race=heard.append, **how)
    assert [*notes.parent.iterdir()] == [notes]  # the user's file stays
    assert [progress.done for progress in heard] == [1, 2]
    assert not kept.exists()  # its episodes are in the dataset
    np.testing.assert_array_equal(demos.columns["controls"], driven[1].columns["controls"])


@pytest.mark.slow
def test_the_command_records(tmp_path, capsys):
    file = tmp_path / "d.safetensors"
    assert main(["demos", *COMMAND, "--output", str(file)]) == 0
    out = capsys.readouterr().out
    assert "drives 1 (0 finished), steps 40, view racing" in out
    assert not (tmp_path / "d.safetensors.parts").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nobody"], "unknown driver 'nobody'"),
        (["ai", "--view", "full"], "differ in size"),
        (["ai", "--view", "racin"], "Did you mean 'racing'"),
        (["ai", "--rivals", "ai:3"], "'ai:3' requires difficulty 3"),
        (["ai", "--output", "d.csv"], "ends in .safetensors"),
    ],
)
def test_invalid_arguments_are_reported(words, text, capsys):
    assert main(["demos", *words]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.slow
def test_an_agent_that_fails_makes_no_demonstrations(tmp_path, capsys):
    bad = tmp_path / "bad.py"
    bad.write_text(
        'env_name = "supertuxkart/racing-v0"\nplayer_name = "bad"\n'
        "def get_actor(*_):\n    return lambda *_: 1 / 0\n"
    )
    words = ["--track", "lighthouse", "--karts", "1", "--output", str(tmp_path / "d.safetensors")]
    assert main(["demos", str(bad), *words]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().err
    assert not (tmp_path / "d.safetensors").exists()


def test_invalid_files_are_refused(driven, tmp_path):
    _, demos = driven
    bad = tmp_path / "bad.safetensors"
    columns = {**demos.columns, "rewards": demos.columns["rewards"][:-1]}
    save_demonstrations(replace(demos, columns=columns), bad)
    with pytest.raises(ConfigError, match="cannot be read as demonstrations"):
        load_demonstrations(bad)
    with pytest.raises(ConfigError, match="there are no demonstrations"):
        load_demonstrations(tmp_path / "none.safetensors")
