"""The tasks are frozen, can be created and have the documented races."""

import json

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from pettingzoo.test import parallel_api_test

from stkzoo.cli import main
from stkzoo.engine.process import LIBM
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, run_race
from stkzoo.race.replay import next_digest
from stkzoo.suite import POPULATION, TASKS, find_task, id_of, plan_entry, view_of
from stkzoo.suite.population import draw_rivals
from stkzoo.tracks import TEST_TRACKS, TRAIN_TRACKS
from tests.support.views import marked

#: Digests of the definitions of stkzoo-suite-1. A changed digest needs another suite.
DIGESTS = {
    "solo-general": "e829041ce9697310",
    "versus": "d4df584086b91c54",
    "selfplay-5": "195180547a07890f",
    "team-2v2": "fea1282a8a1ffc20",
}


def test_the_tasks_are_those_of_the_suite():
    assert {name: task.digest[:16] for name, task in TASKS.items()} == DIGESTS


@pytest.mark.slow
@pytest.mark.parametrize("name", marked(DIGESTS, ["versus", "team-2v2"]))
def test_a_task_can_be_made_and_raced(name):
    task = find_task(name)
    env = task.make(max_cycles=60)
    parallel_api_test(env, num_cycles=40)
    assert len(env.possible_agents) == task.learners
    race = env.unwrapped
    assert race.options.num_kart == task.num_kart
    env.reset(seed=1)
    assert race.race.track in task.train_tracks
    assert race.race.difficulty == 3
    env.close()


@pytest.mark.parametrize("name", marked(["solo-general", "versus"], ["versus"]))
def test_a_task_with_one_learner_is_a_gymnasium_environment(name):
    """It drives the same races as the parallel form."""
    task = find_task(name)
    with gym.make(id_of(task)) as env, task.make() as parallel:
        one, _ = env.reset(seed=3)
        other, _ = parallel.reset(seed=3)
        assert (one == other["kart_0"]).all()
        action = np.array([10, 0, 0, 0, 0])
        for _ in range(20):
            one, reward, *_ = env.step(action)
            other, rewards, *_ = parallel.step({"kart_0": action})
            assert (one == other["kart_0"]).all()
            assert reward == rewards["kart_0"]
    envs = gym.make_vec(id_of(task), num_envs=2)
    assert envs.reset(seed=3)[0].shape == (2, 205)
    envs.close()


@pytest.mark.skipif(not hasattr(pettingzoo, "register"), reason="needs PettingZoo 1.27")
def test_each_task_is_registered_with_pettingzoo():
    for task in TASKS.values():
        env = pettingzoo.make("parallel", id_of(task))
        assert len(env.possible_agents) == task.learners
        env.close()


@pytest.mark.slow
def test_both_splits_and_both_directions_are_driven():
    assert set(find_task("versus").options()["track"]) == set(TRAIN_TRACKS)
    with find_task("solo-general").make("test") as env:
        seen = set()
        for seed in range(12):
            env.reset(seed=seed)
            seen.add((env.race.track in TEST_TRACKS, env.race.reverse))
    assert seen == {(True, False), (True, True)}
    with pytest.raises(ConfigError, match="unknown split 'validation'"):
        find_task("versus").options("validation")


def test_a_team_shares_its_rewards():
    env = find_task("team-2v2").make(max_cycles=60)
    env.reset(seed=1)
    straight = np.array([10, 0, 0, 0, 0])
    for _ in range(30):
        _, rewards, *_ = env.step(dict.fromkeys(env.agents, straight))
    assert rewards["kart_0"] == rewards["kart_1"] != rewards["kart_2"] == rewards["kart_3"]
    env.close()


@pytest.mark.slow
def test_an_agent_can_name_each_task_as_its_view(tmp_path):
    versus = tmp_path / "versus.py"
    versus.write_text(
        f"env_name = {id_of(find_task('versus'))!r}\n"
        "def get_actor(module_dir, seen, acted):\n"
        "    assert seen.shape == (205,)\n"
        "    return lambda state, observation: [10, 0, 0, 0, 0]\n"
    )
    race = {"track": "lighthouse", "seed": 5, "max_steps": 3, "error_handling": "raise"}
    assert run_race([str(versus)], **race).agents[0].num_errors == 0
    with pytest.raises(ConfigError, match=r"Known: .*stkzoo-suite/team-2v2-v1"):
        view_of("stkzoo-suite/team-2v2-v0")


class MotionDigest(RaceListener):
    """Computes the digest of all karts' motion in a race."""

    digest = b""

    def started(self, race):
        self.digest = next_digest(self.digest, race.snapshot)

    stepped = started


@pytest.mark.skipif(not LIBM.exists(), reason="needs Linux")
@pytest.mark.parametrize(
    "member",
    marked(POPULATION, [m for m in POPULATION if m.driver in ("ai:2", "pretrained:ace")]),
    ids=lambda member: member.driver,
)
def test_a_member_of_the_population_still_drives_the_same(member):
    motion, race = MotionDigest(), {"track": "lighthouse", "difficulty": 3, "seed": 1}
    drivers, places = [member.driver, "ai"], (1, 2)
    run_race(drivers, listeners=[motion], start_positions=places, wait_for=(0,), **race)
    assert motion.digest.hex() == member.digest


@pytest.mark.parametrize("name", DIGESTS)
def test_the_evaluation_has_balanced_and_reproducible_races(name):
    task, plan = find_task(name), plan_entry(name, "random")
    orders = plan.orders()
    assert len(orders) == task.num_races
    assert orders == plan_entry(name, "random").orders()
    assert {order.settings.track for order in orders} == set(task.test_tracks)
    assert {order.settings.teams for order in orders} == {bool(task.teams)}
    assert sum(order.settings.reverse for order in orders) == len(orders) / 2
    assert len({order.settings.seed for order in orders}) == len(orders)
    for order in orders:
        assert len(order.drivers) in map(len, task.forms)
        assert sum("random" in text for text in order.drivers) == len(order.wait_for)


def test_members_of_the_population_take_turns():
    races = plan_entry("selfplay-5", "random").races()
    drawn = draw_rivals(races)
    assert sorted(drawn) == [race.number for race in races if race.lineup.has_population]
    times = {member.driver: 0 for member in POPULATION}
    for rivals in drawn.values():
        assert len({text for text in rivals if text.startswith("ai:")}) <= 1
        assert len(set(rivals)) == len(rivals)
        for text in rivals:
            times[text] += 1
    assert max(times.values()) - min(times.values()) < 0.2 * min(times.values())


def test_the_command_lists_tasks_with_their_rules(capsys):
    assert main(["suite", "list"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in (*TASKS, "pretrained:ace"))
    assert main(["suite", "list", "versus"]) == 0
    assert find_task("versus").digest in capsys.readouterr().out
    assert main(["suite", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [task["name"] for task in listed["tasks"]] == list(TASKS)
    assert main(["suite", "list", "verse"]) == 2
    assert "Did you mean 'versus'?" in capsys.readouterr().err
