"""Learned drivers: checks of their files, and races."""

import json
import struct
from dataclasses import asdict

import numpy as np
import pytest
import safetensors.numpy

from stkzoo import race_v0
from stkzoo.agents.planning.driver import ALL_LOOKS, CHOICES, INPUT_SIZE
from stkzoo.agents.planning.memory import MEMORY_SIZE
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained import action_filter
from stkzoo.agents.pretrained.driver import make_actor, make_batch_actor, new_state, read_policy
from stkzoo.agents.pretrained.ensemble import EnsemblePolicy, join_members, members_of
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy, check_shapes
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.agents.training.export import export_policy, main
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, driver_names, find_driver, run_race
from stkzoo.wrappers.racing import CONTEST_SIZE, PLACES, surroundings_of
from tests.support.networks import small_network

LEARNED = [name for name in driver_names() if name.startswith("pretrained:")]
INPUTS, OUTPUTS = INPUT_SIZE, sum(CHOICES)


def network(hidden=8, seed=0):
    chance = np.random.default_rng(seed)
    weights = {"mean": np.zeros(INPUTS, np.float32), "scale": np.ones(INPUTS, np.float32)}
    sizes = (INPUTS, hidden, hidden, OUTPUTS)
    for layer in range(3):
        shape = sizes[layer], sizes[layer + 1]
        weights[f"w{layer}"] = chance.normal(0, 0.1, shape).astype(np.float32)
        weights[f"b{layer}"] = np.zeros(sizes[layer + 1], np.float32)
    return weights


@pytest.fixture
def agent(tmp_path):
    save_weights(tmp_path / "policy-000000123.safetensors", network())
    return export_policy(tmp_path / "policy-000000123.safetensors", "tiny", tmp_path / "tiny")


@pytest.fixture
def quick_agent(tmp_path):
    """Exports a network without plans as an agent."""
    run = tmp_path / "run"
    run.mkdir()
    save_weights(run / "policy-000000123.safetensors", small_network())
    (run / "arguments.json").write_text(json.dumps({"seed": 7, "tracks": ["lighthouse"]}))
    return export_policy(run / "policy-000000123.safetensors", "quick", tmp_path / "quick")


@pytest.mark.slow
def test_a_network_without_plans_can_be_exported(quick_agent):
    card = json.loads((quick_agent / "card.json").read_text())
    assert card["runs"][0]["history"] == [
        {"from": 0, "arguments": {"seed": 7, "tracks": ["lighthouse"]}}
    ]
    assert "rules" not in card
    assert "value_net.bias" not in load_weights(quick_agent / "weights.safetensors")
    driver = read_policy(quick_agent)
    assert (driver.hold, driver.inputs) == (1, action_filter.INPUT_SIZE)
    result = run_race([str(quick_agent)], track="olivermath", max_steps=25)
    assert result.agents[0].num_errors == 0


@pytest.mark.slow
def test_an_agent_in_the_contest_view_can_sample_its_choices(tmp_path):
    """A race repeats, and the agent's karts draw different choices."""
    inputs = CONTEST_SIZE + MEMORY_SIZE
    save_weights(tmp_path / "policy.safetensors", small_network(inputs=inputs))
    race = {"track": "olivermath", "max_steps": 30, "seed": 3, "inline": True}
    results = {}
    for name in ("samples", "again", "likeliest"):
        samples = name != "likeliest"
        folder = tmp_path / name
        export_policy(tmp_path / "policy.safetensors", name, folder, samples=samples)
        assert 'env_name = "supertuxkart/contest-v0"' in (folder / "pystk_actor.py").read_text()
        recorder = Controls()
        run_race([str(folder)] * 2, **race, listeners=[recorder])
        results[name] = np.array(recorder.rows)
    assert (results["samples"] == results["again"]).all()
    assert (results["samples"] != results["likeliest"]).any()
    assert (results["samples"][:, 0] != results["samples"][:, 1]).any()


def recurrent_network(inputs=CONTEST_SIZE + MEMORY_SIZE, size=16):
    chance = np.random.default_rng(1)
    shapes = {"seen.weight": (3 * size, inputs), "seen.bias": (3 * size,)}
    unit = {
        f"memory.{name}": chance.normal(0, 0.2, shape).astype(np.float32)
        for name, shape in {**shapes, "kept.weight": (3 * size, size)}.items()
    }
    return small_network(inputs=inputs + size) | unit


def test_each_kart_of_a_recurrent_agent_has_its_own_memory(tmp_path):
    """Karts driven together have the same memory as if driven one by one, bit for bit."""
    save_weights(tmp_path / "policy.safetensors", recurrent_network())
    agent = export_policy(tmp_path / "policy.safetensors", "mindful", tmp_path / "mindful")
    act, act_together = make_actor(agent), make_batch_actor(agent)
    alone, together = ([new_state(agent) for _ in range(3)] for _ in range(2))
    chance = np.random.default_rng(0)
    for step in range(6):
        seen = chance.normal(size=(3, CONTEST_SIZE)).astype(np.float32)
        seen[: 2 if step < 3 else 3, PLACES["velocity"]] = 1.0
        seen[2 if step < 3 else 3 :, PLACES["velocity"]] = 0.0  # on the grid
        singly = [act(state, row) for state, row in zip(alone, seen, strict=True)]
        assert np.array_equal(act_together(together, list(seen)), singly)
        memory = np.concatenate([state.recurrent for state in alone])
        assert np.array_equal(np.concatenate([state.recurrent for state in together]), memory)
        assert memory.any(axis=1).tolist() == [True, True, step >= 3]


def test_weights_of_a_memory_with_other_shapes_are_refused():
    weights = recurrent_network() | {"memory.seen.bias": np.zeros(47, np.float32)}
    with pytest.raises(ConfigError, match=r"memory.seen.bias.* of .*\(47,\).*\(48,\)"):
        MlpDriver(weights)
    with pytest.raises(ConfigError, match="recurrent network, expected networks without memory"):
        members_of(join_members([recurrent_network()], []), "mixed")


class Controls(RaceListener):
    """Records the controls of all karts in each step."""

    def __init__(self):
        self.rows = []

    def stepped(self, race):
        self.rows.append(race.snapshot.karts["control"].copy())


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-4],
        lambda data: struct.pack("<Q", 1 << 60) + data[8:],
        lambda data: data.replace(b'"shape":[8]', b'"shape":[9]'),
    ],
    ids=["cut", "huge header", "other shape"],
)
def test_damaged_weights_are_refused(tmp_path, spoil):
    file = tmp_path / "w.safetensors"
    save_weights(file, network())
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(ConfigError, match="no safetensors file"):
        load_weights(file)


def test_weights_of_another_type_are_refused(tmp_path):
    safetensors.numpy.save_file({"a": np.zeros(3)}, tmp_path / "w.safetensors")
    with pytest.raises(ConfigError, match=r"numbers of \['float64'\], expected float32"):
        load_weights(tmp_path / "w.safetensors")


def test_weights_that_do_not_match_the_card_are_refused(agent):
    save_weights(agent / "weights.safetensors", network(seed=1))
    with pytest.raises(ConfigError, match=r"not those of the card.*SHA-256"):
        read_policy(agent)


def test_a_missing_card_is_refused(agent):
    (agent / "card.json").unlink()
    with pytest.raises(ConfigError, match="no card of a learned agent"):
        read_policy(agent)


@pytest.mark.parametrize("rules", [{"wheel": 1.0}, "many", None])
def test_a_card_of_other_plans_is_refused(agent, rules):
    change_card(agent, rules=rules)
    with pytest.raises(ConfigError, match="not those of this version"):
        new_state(agent)


def test_plans_use_the_parameters_on_the_card(agent):
    with race_v0.parallel_env(num_kart=1, track="olivermath") as env:
        observation = env.reset(seed=1)[0]["kart_0"]
    around = surroundings_of(observation, ALL_LOOKS)
    usual = new_state(agent).view(around).inputs
    change_card(agent, rules=asdict(DriverParameters(late_cost=40.0, margin=3.0)))
    assert (new_state(agent).view(around).inputs != usual).any()


def change_card(folder, **facts):
    file = folder / "card.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), **facts}))


def test_weights_with_invalid_shapes_or_values_are_refused():
    weights = network()
    weights["w0"] = weights["w0"][:-1]
    with pytest.raises(ConfigError, match="from another version"):
        check_shapes(weights, "w")
    weights = network()
    weights["b2"][3] = np.nan
    with pytest.raises(ConfigError, match="finite"):
        check_shapes(weights, "w")


def test_the_card_records_the_training_runs(tmp_path, capsys):
    file = tmp_path / "policy-000000123.safetensors"
    save_weights(file, network())
    (tmp_path / "arguments.json").write_text(
        json.dumps(
            [{"from": 0, "arguments": {"seed": 5, "tracks": ["mines"]}, "rules": {"margin": 2.0}}]
        )
    )
    assert main([str(file), "--name=tiny", f"--output={tmp_path / 'agent'}"]) == 0
    card = json.loads((tmp_path / "agent" / "card.json").read_text())
    (run,) = card["runs"]
    assert (run["kart_steps"], run["history"][0]["arguments"]["seed"]) == (123, 5)
    assert card["rules"] == asdict(DriverParameters(margin=2.0))
    assert "stkzoo race" in capsys.readouterr().out


def test_exporting_does_not_overwrite_other_folders(tmp_path, capsys):
    file = tmp_path / "w.safetensors"
    save_weights(file, network())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("dear")
    assert main([str(file), "--name=tiny", f"--output={tmp_path / 'mine'}"]) == 1
    assert "is not the folder of an agent" in capsys.readouterr().err
    (tmp_path / "mine" / "card.json").write_text('{"name": "Ada"}')
    assert main([str(file), "--name=tiny", f"--output={tmp_path / 'mine'}"]) == 1
    assert "card.json" in capsys.readouterr().err
    assert (tmp_path / "mine" / "card.json").read_text() == '{"name": "Ada"}'
    with pytest.raises(ConfigError, match="expected letters"):
        export_policy(file, "a b", tmp_path / "other")


@pytest.mark.slow
@pytest.mark.parametrize("step", ["write_json", "save_weights", "write_text"])
def test_an_interrupted_export_can_be_repeated(step, agent, tmp_path, monkeypatch):
    def interrupt(path, *_):
        path.with_name(f".stkzoo-{path.name}.a1b2c3d4.part").touch()
        raise KeyboardInterrupt

    file, again = tmp_path / "policy-000000123.safetensors", tmp_path / "again"
    with monkeypatch.context() as patched:
        patched.setattr(f"stkzoo.agents.training.export.{step}", interrupt)
        with pytest.raises(KeyboardInterrupt):
            export_policy(file, "tiny", again)
    export_policy(file, "tiny", again)
    for name in ("card.json", "weights.safetensors", "pystk_actor.py", "__init__.py"):
        assert (again / name).read_bytes() == (agent / name).read_bytes()


@pytest.mark.slow
def test_an_exported_folder_races_like_any_agent(agent):
    result = run_race([str(agent), "ai"], track="olivermath", seed=1, max_steps=60)
    mine = next(row for row in result.agents if row.agent == "kart_0")
    assert mine.driver == "tiny"
    assert mine.errors == ()


def test_an_unknown_learned_driver_is_refused_with_the_nearest_name():
    with pytest.raises(ConfigError, match="Did you mean 'pretrained:scout'"):
        find_driver("pretrained:scot")


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNED)
def test_a_shipped_driver_reaches_the_finish(name):
    result = run_race([name], track="lighthouse", seed=3, difficulty=3)
    assert result.is_finished
    assert result.agents[0].errors == ()


@pytest.mark.parametrize("name", LEARNED)
def test_a_shipped_driver_is_small_and_has_a_card(name):
    import importlib
    from pathlib import Path

    module = importlib.import_module(f"stkzoo.agents.{name.replace(':', '.')}")
    folder = Path(module.__file__).parent
    assert (folder / "weights.safetensors").stat().st_size < 2_000_000
    assert (folder / "CARD.md").is_file()
    kinds = dict.fromkeys(("ace", "apex", "zenith"), EnsemblePolicy)
    kinds |= dict.fromkeys(("scout", "hunter", "raider"), RacingPolicy)
    kinds |= dict.fromkeys(("rookie", "regular"), MlpDriver)
    assert isinstance(read_policy(folder), kinds[name.partition(":")[2]])


def test_it_holds_full_throttle_before_the_start_and_then_drives(agent):
    actor, state = make_actor(agent), new_state(agent)
    with race_v0.parallel_env(num_kart=1, track="lighthouse") as env:
        observations, _ = env.reset(seed=1)
        for step in range(40):
            action = actor(state, observations["kart_0"])
            assert env.action_space("kart_0").contains(action)
            if step < 10:
                assert (action["acceleration"][0], action["brake"], action["drift"]) == (1.0, 0, 0)
            observations, *_ = env.step({"kart_0": action})
        assert env.snapshot.karts[0]["speed"] > 5


def test_invalid_levels_of_the_ai_are_refused():
    with pytest.raises(ConfigError, match="expected ai:0"):
        find_driver("ai:4")
    with pytest.raises(ConfigError, match="one level"):
        run_race(["ai:1", "ai:2"], track="olivermath")
