"""Ensembles, which choose by the values of plans and the preferences of networks."""

import json
from contextlib import closing

import numpy as np
import pytest

from stkzoo.agents.planning.driver import (
    PolicyInput,
    is_drifting,
)
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.view import PlanVectorEnv
from stkzoo.agents.pretrained.driver import read_numbers, read_policy
from stkzoo.agents.pretrained.ensemble import EnsemblePolicy
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy, network_shapes
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.agents.training.common.matches import match_driver
from stkzoo.agents.training.evaluate import evaluate
from stkzoo.agents.training.export import export_policy, main
from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.wrappers.racing import CHOICES
from tests.support.networks import small_network

STEER, PEDAL, DRIFT, NITRO, FIRE = np.cumsum((0, *CHOICES[:-1]))


def ensemble(weight, *networks):
    return EnsemblePolicy([MlpDriver(weights) for weights in networks or [small_network()]], weight)


@pytest.fixture(scope="module")
def views():
    """Returns 50 views of four karts in a race that the plans drive."""
    race = {"num_kart": 4, "agents": 4, "track": "snowmountain"}
    plans, seen = RacingPolicy.of_plans_alone(), []
    with closing(PlanVectorEnv(num_starts=1, skip_countdown=True, **race)) as races:
        observations, _ = races.reset(seed=1)
        for step in range(200):
            view = PolicyInput(**observations)
            if step % 4 == 0:
                seen.append(view)
            observations, *_ = races.step(plans.best(view))
    assert any(is_drifting(view.inputs).any() for view in seen)
    return seen


def test_with_weight_0_the_plans_decide_alone(views):
    plans = RacingPolicy.of_plans_alone()
    assert all((ensemble(0.0).best(view) == plans.best(view)).all() for view in views)


def test_a_larger_weight_changes_more_choices(views):
    def changed(weight):
        policy, plans = ensemble(weight), RacingPolicy.of_plans_alone()
        return np.mean([policy.best(view) != plans.best(view) for view in views])

    assert 0 < changed(2.0) < changed(50.0)


def test_several_networks_are_averaged(views):
    one, other = small_network(seed=1), small_network(seed=2)
    view = views[20]
    both, swapped = ensemble(2.0, one, other), ensemble(2.0, other, one)
    assert (both.best(view) == swapped.best(view)).all()
    assert (ensemble(2.0, one, one).best(view) == ensemble(2.0, one).best(view)).all()
    drifts, brakes = small_network([DRIFT + 1]), small_network([DRIFT])
    undecided = [ensemble(1e3, drifts, brakes).best(view) for view in views]
    assert len({int(begin) for best in undecided for begin in best[:, 0]}) > 1


@pytest.fixture
def files(tmp_path):
    """Writes the networks of two training runs and returns the paths."""
    paths = []
    for seed in (0, 1):
        run = tmp_path / f"run{seed}"
        run.mkdir()
        save_weights(run / "policy-000000123.safetensors", small_network(seed=seed))
        (run / "arguments.json").write_text(json.dumps({"seed": seed, "tracks": ["mines"]}))
        paths.append(str(run / "policy-000000123.safetensors"))
    return paths


@pytest.mark.slow
def test_networks_become_an_agent(files, tmp_path, capsys):
    folder = tmp_path / "wise"
    assert main([*files, "--name=wise", f"--output={folder}", "--ensemble-weight=0.5"]) == 0
    capsys.readouterr()
    card = json.loads((folder / "card.json").read_text())
    assert [run["history"][0]["arguments"]["seed"] for run in card["runs"]] == [0, 1]
    assert card["parameters"] == sum(
        a.size for a in load_weights(folder / "weights.safetensors").values()
    )
    policy = read_policy(folder)
    assert isinstance(policy, EnsemblePolicy)
    assert (len(policy.networks), policy.weight) == (2, 0.5)
    result = run_race([str(folder), "ai"], track="olivermath", seed=1, max_steps=60)
    mine = next(row for row in result.agents if row.agent == "kart_0")
    assert (mine.driver, mine.errors) == ("wise", ())


@pytest.mark.slow
def test_an_agent_with_plans_on_the_racing_line_sees_the_ground(files, tmp_path):
    plans = tmp_path / "plans.json"
    plans.write_text(json.dumps({"racing_line": True}))
    folder = export_policy(files[:1], "liner", tmp_path / "liner", 1.0, plans)
    assert 'env_name = "supertuxkart/ground-v0"' in (folder / "pystk_actor.py").read_text()
    result = run_race([str(folder), "ai"], track="olivermath", seed=1, max_steps=60)
    mine = next(row for row in result.agents if row.agent == "kart_0")
    assert (mine.driver, mine.errors) == ("liner", ())


@pytest.mark.slow
def test_agents_are_compared_with_policies(files, tmp_path):
    one = export_policy(files[:1], "one", tmp_path / "one", ensemble_weight=0.0)
    quick = export_policy(files[0], "quick", tmp_path / "quick")
    drivers = [match_driver(source) for source in ("prior", one, files[0], quick)]
    prior, own, network, agent = evaluate(drivers, ["olivermath"], 1, bots=0)
    assert prior == own
    assert network == agent
    assert prior[0][0].counted_ratio < 1


@pytest.mark.parametrize(
    ("weight", "message"), [(None, "several networks"), (np.nan, "ensemble_weight is nan")]
)
def test_invalid_ensembles_are_refused(files, tmp_path, weight, message):
    with pytest.raises(ConfigError, match=message):
        export_policy(files, "wise", tmp_path / "wise", weight)
    assert not (tmp_path / "wise").exists()


def plan_policy(seed):
    """Returns a policy over plans with random weights."""
    random, shapes = np.random.default_rng(seed), network_shapes((4, 4))
    return {name: random.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def test_the_learned_logits_of_policies_over_plans_are_added_to_the_prior(views):
    one, other = (RacingPolicy(plan_policy(seed)) for seed in (0, 1))
    network = MlpDriver(small_network())
    both, plain = EnsemblePolicy([network], 1.0, [one, other]), EnsemblePolicy([network], 1.0)
    differences = 0
    for view in views:
        mean = (one.learned_logits(view) + other.learned_logits(view)) / 2
        raised = PolicyInput(view.inputs, view.prior + mean)
        assert (both.best(view) == plain.best(raised)).all()
        differences += (both.best(view) != plain.best(view)).sum()
    assert differences > 10


@pytest.fixture
def plan_file(tmp_path):
    """Writes a policy over plans from a run with held offsets, and returns its path."""
    run = tmp_path / "plans"
    run.mkdir()
    rules = {"turn_hold": 4}
    arguments = {"from": 0, "arguments": {"seed": 7, "tracks": ["mines"]}, "rules": rules}
    (run / "arguments.json").write_text(json.dumps([arguments]))
    save_weights(run / "policy-000000456.safetensors", plan_policy(3))
    return run / "policy-000000456.safetensors"


@pytest.mark.slow
def test_policies_over_plans_and_networks_become_one_agent(files, plan_file, tmp_path):
    folder = export_policy([*files, plan_file], "wise", tmp_path / "wise", ensemble_weight=1.0)
    policy = read_policy(folder)
    assert isinstance(policy, EnsemblePolicy)
    assert (len(policy.networks), len(policy.policies)) == (2, 1)
    assert read_numbers(folder).turn_hold == 4
    result = run_race([str(folder)], track="olivermath", seed=1, max_steps=60)
    assert result.agents[0].errors == ()


def test_the_folder_of_an_ensemble_adds_its_members(files, plan_file, tmp_path):
    networks = export_policy(files, "wise", tmp_path / "wise", ensemble_weight=1.0)
    once = export_policy([*files, plan_file], "once", tmp_path / "once", ensemble_weight=1.0)
    again = export_policy([networks, plan_file], "again", tmp_path / "again", ensemble_weight=1.0)
    one, other = (json.loads((folder / "card.json").read_text()) for folder in (once, again))
    assert one["sha256"] == other["sha256"]
    assert one["runs"] == other["runs"]


def test_a_card_with_damaged_runs_is_refused(files, tmp_path):
    folder = export_policy(files, "wise", tmp_path / "wise", ensemble_weight=1.0)
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps({**card, "runs": 5}))
    with pytest.raises(ConfigError, match=r"card\.json' is no card of a learned agent"):
        export_policy([folder], "again", tmp_path / "again", ensemble_weight=1.0)
    assert not (tmp_path / "again" / "card.json").exists()


def test_only_an_ensemble_can_use_other_plans(files, plan_file, tmp_path):
    plans = tmp_path / "best.json"
    plans.write_text(json.dumps({"learned_motion": True, "margin": 0.5}))
    folder = export_policy(files, "wise", tmp_path / "wise", 1.0, plans)
    assert read_numbers(folder) == DriverParameters(learned_motion=True, margin=0.5)
    mixed = export_policy([*files, plan_file], "mixed", tmp_path / "mixed", 1.0, plans)
    assert read_numbers(mixed) == read_numbers(folder)
    with pytest.raises(ConfigError, match="add --ensemble-weight 1"):
        export_policy(plan_file, "plain", tmp_path / "plain", plans=plans)


def test_a_folder_without_an_ensemble_is_refused(plan_file, tmp_path):
    folder = export_policy(plan_file, "plain", tmp_path / "plain")
    with pytest.raises(ConfigError, match="is not an ensemble"):
        export_policy([folder], "wise", tmp_path / "wise", ensemble_weight=1.0)


def test_policies_of_runs_with_different_plans_are_refused(plan_file, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    save_weights(other / "policy-000000789.safetensors", plan_policy(4))
    (other / "arguments.json").write_text(json.dumps([{"from": 0, "arguments": {}, "rules": {}}]))
    files = [plan_file, other / "policy-000000789.safetensors"]
    with pytest.raises(ConfigError, match="runs with different plans"):
        export_policy(files, "wise", tmp_path / "wise", ensemble_weight=1.0)
