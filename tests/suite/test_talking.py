"""In races, agents of talk-2v2 see and hear the same as during training."""

import importlib.util
from contextlib import closing

import pytest

from stkzoo.config import AgentSpec
from stkzoo.errors import ConfigError
from stkzoo.race import RaceListener, find_driver, run_race
from stkzoo.suite import TASKS, Task, evaluate, find_task, id_of, plan_entry, verify_entry, view_of
from stkzoo.suite.entry import entry_orders
from tests.support.paths import AGENTS, ROOT

TASK = find_task("talk-2v2")
EXAMPLE = str(ROOT / "examples" / "talking")
CHECKSUMS = str(AGENTS / "talking")
RACE = {"track": "lighthouse", "seed": 5}
#: The teams and the start positions of the task's learners.
TEAMS, GRID = ("@:Red", "@:Blue", "@:Blue", "@:Red"), (1, 2, 3, 4)

#: Two races with two karts of the agent and one of the population.
SMALL = Task(
    name="small-talk",
    goal="Be verified quickly.",
    train_tracks=("lighthouse",),
    test_tracks=("lighthouse",),
    learners=4,
    teams=TASK.teams,
    sight=TASK.sight,
    words=TASK.words,
    forms=("PPB",),
    seeds=1,
)


class Motion(RaceListener):
    """Records all karts at the start and after each step."""

    def __init__(self):
        self.karts = []

    def started(self, race):
        self.karts.append(race.env.snapshot.karts.tobytes())

    stepped = started


def environment(**options):
    specs = [AgentSpec(place - 1, color=n / 4) for n, place in enumerate(GRID)]
    return TASK.make(track="lighthouse", reverse=False, agents=specs, **options)


def karts(env):
    return env.unwrapped.snapshot.karts.tobytes()


def actors():
    """Returns a function that makes an actor of the checksum agent for given spaces."""
    file = AGENTS / "talking" / "pystk_actor.py"
    spec = importlib.util.spec_from_file_location("checksums", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def make(seen, acted):
        actor, memory = module.get_actor(None, seen, acted), module.create_state()
        return lambda observation: actor(memory, observation)

    return make


@pytest.mark.slow
@pytest.mark.parametrize("inline", [False, True])
def test_a_race_of_two_teams_equals_that_of_the_tasks_environment(inline):
    """Each action depends on every bit that its kart has observed and heard."""
    motion, steps = Motion(), 150
    drivers = [CHECKSUMS + team for team in TEAMS]
    changes = {"difficulty": 3, "max_steps": steps, "inline": inline, "error_handling": "raise"}
    run_race(drivers, start_positions=GRID, listeners=[motion], **RACE, **changes)
    make = actors()
    with closing(environment()) as env:
        observations, _ = env.reset(seed=RACE["seed"])
        acting = {a: make(env.observation_space(a), env.action_space(a)) for a in env.agents}
        driven = [karts(env)]
        for _ in range(steps):
            actions = {agent: acting[agent](observations[agent]) for agent in env.agents}
            observations = env.step(actions)[0]
            driven.append(karts(env))
    assert driven == motion.karts


@pytest.mark.slow
def test_an_entry_of_an_agent_that_talks_is_verified(tmp_path, monkeypatch):
    monkeypatch.setitem(TASKS, SMALL.name, SMALL)
    entry = evaluate(SMALL, EXAMPLE, output=tmp_path / "entry", plot=False)
    assert [kart.errors for race in entry.races for kart in race.karts] == [0] * 8
    assert all(kart.time for race in entry.races for kart in race.karts)
    assert verify_entry(tmp_path / "entry").races == entry.races


def test_agents_that_do_not_talk_can_race_in_the_task():
    assert find_driver(EXAMPLE).words == find_driver(EXAMPLE, inline=True).words == 8
    assert find_driver("heuristic").words == find_driver(str(AGENTS / "plain")).words == 0
    for agent in (EXAMPLE, "heuristic", str(AGENTS / "plain")):
        orders = entry_orders(plan_entry("talk-2v2", agent))
        assert len(orders) == TASK.num_races


@pytest.mark.parametrize("task", ["versus", "team-2v2"])
def test_an_agent_does_not_talk_in_tasks_without_words(task):
    with pytest.raises(ConfigError, match=f"says one of 8 words, and {task} has none"):
        plan_entry(task, EXAMPLE)


@pytest.mark.slow
def test_an_agent_can_name_each_task_as_its_view(tmp_path):
    versus = tmp_path / "versus.py"
    versus.write_text(
        f"env_name = {id_of(find_task('versus'))!r}\n"
        "def get_actor(module_dir, seen, acted):\n"
        "    assert seen.shape == (165,)\n"
        "    return lambda state, observation: [10, 0, 0, 0, 0]\n"
    )
    result = run_race([str(versus)], max_steps=3, error_handling="raise", **RACE)
    assert result.agents[0].num_errors == 0
    with pytest.raises(ConfigError, match="Did you mean 'stkzoo-suite/talk-2v2-v1'"):
        view_of("stkzoo-suite/talk-2v2-v0")
