"""Observations of the ground along the road ahead."""

import shutil
import sys
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.drivers.files import declared, find_files
from stkzoo.engine.track import TrackMap
from stkzoo.errors import AgentError, ConfigError
from stkzoo.evaluation import DemoView
from stkzoo.mdp.spaces import GROUND_LANES, GROUND_MARKS
from stkzoo.names import GroundKind
from stkzoo.race import find_driver, run_race
from stkzoo.race.remote import RemoteDriverGroup
from stkzoo.wrappers.racing import ground_observer
from stkzoo.wrappers.racing.racing_line import GroundTable
from tests.engine.test_ground import FLOOR, ground_with, plate, wall
from tests.support.remote_race import server_thread

VOID, GROUND, SLOWED, ZIPPER, WALL = GroundKind
MIDDLE = len(GROUND_LANES) // 2


def straight_track(segments=8, length=5.0):
    ends = np.zeros((segments, 2, 3), np.float32)
    ends[:, 0, 2] = length * np.arange(segments)
    ends[:, 1, 2] = ends[:, 0, 2] + length
    return TrackMap(
        length=segments * length,
        path_nodes=ends,
        path_width=np.full((segments, 1), 10.0, np.float32),
        path_distance=ends[..., 2].copy(),
        successors=[[n + 1] for n in range(segments - 1)] + [[]],
    )


def lane(meters):
    return int(np.abs(GROUND_LANES - meters).argmin())


def mark(meters):
    return int(np.abs(GROUND_MARKS - meters).argmin())


@pytest.fixture(scope="module")
def ahead():
    """Returns the ground ahead of two karts, on a straight road with obstacles."""
    ground = ground_with(
        FLOOR,
        wall(4.3, (10, 14), (0, 2)),
        plate((-6.2, -4.0), (16, 21), 0.05, is_reset=True),
        plate((-1.0, 1.0), (22, 26), 0.05, is_zipper=True),
        plate((6.5, 10), (0, 40), 0.05, speed=0.5),
    )
    table = GroundTable(straight_track(), ground)
    return table.ahead(np.array([0, 1]), np.array([[0.3, 0.5, 0.0], [0.0, 0.5, 6.0]], np.float32))


def test_the_ground_is_observed_in_the_right_places(ahead):
    kind, speed = ahead
    assert kind.shape == speed.shape == (2, len(GROUND_MARKS), len(GROUND_LANES))
    first, second = kind
    assert first[mark(12), lane(4.5)] == WALL
    assert first[mark(12), lane(-4.5)] == GROUND
    assert second[mark(6), lane(4.5)] == WALL
    assert first[mark(18), lane(-5.25)] == VOID
    assert first[mark(24), lane(0)] == ZIPPER
    assert first[mark(3), lane(7.5)] == SLOWED
    assert speed[0, mark(3), lane(7.5)] == pytest.approx(0.5)
    assert (first[mark(3), lane(-6) : lane(6)] == GROUND).all()
    assert (first[mark(60) :] == VOID).all()


# ------------------------------------------------------------------ in races


@pytest.mark.slow
def test_only_agents_that_request_the_ground_observe_it():
    views = {"kart_1": "ground"}
    with race_v0.parallel_env(num_kart=3, track="hacienda", view=views) as env:
        observations, _ = env.reset(seed=4)
        for _ in range(12):
            for agent, seen in observations.items():
                assert env.observation_space(agent).contains(seen)
                assert ("ground_kind" in seen) == (agent == "kart_1")
            observations, *_ = env.step({a: env.action_space(a).sample() for a in env.agents})
        observer = ground_observer(env.track_map, env.ground)
        for key, rows in observer.observe(
            env.snapshot, np.array(env.race.kart_indices[1:2])
        ).items():
            np.testing.assert_array_equal(observations["kart_1"][key], rows[0])
        assert (observations["kart_1"]["ground_kind"][:4, MIDDLE] == GROUND).all()


def test_user_defined_views_can_request_the_ground():
    class Clearance(gym.ObservationWrapper):
        """Observes the kind of ground along the center line ahead."""

        def __init__(self, env):
            super().__init__(env)
            self.observation_space = gym.spaces.Box(0, 4, (len(GROUND_MARKS),), np.uint8)

        def observation(self, observation):
            return observation["ground_kind"][:, MIDDLE]

    def clearance(env):
        return Clearance(env)

    clearance.sees_ground = True
    with race_v0.parallel_env(num_kart=2, track="lighthouse", view=clearance) as env:
        seen, _ = env.reset(seed=1)
        assert env.observation_space("kart_0").contains(seen["kart_0"])


def test_demonstrations_do_not_depend_on_the_ground():
    with race_v0.parallel_env(num_kart=2, track="lighthouse", view={"kart_1": "ground"}) as env:
        seen, _ = env.reset(seed=1)
    view = DemoView("simple")
    blind = view.observe({key: seen["kart_1"][key] for key in seen["kart_0"]})
    told = view.observe(seen["kart_1"])
    assert told.keys() == blind.keys() == view.observation_space.spaces.keys()
    np.testing.assert_array_equal(told["paths_start"], blind["paths_start"])


def test_around_an_environment_without_ground_the_view_is_an_error():
    with pytest.raises(ConfigError, match=r"observes the ground.*Choose view='ground'"):
        stkzoo.views.VIEWS["ground"](gym.make("supertuxkart/full-v0"))


# ------------------------------------------------------------------ agents from files

GROUND_AGENT = """
env_name = "supertuxkart/ground-v0"
player_name = "Mole"


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        assert observation_space.contains(observation)
        assert observation["ground_kind"].shape == (36, 25)
        return {**action_space.sample(), "acceleration": observation["ground_speed"][0, :1]}

    return actor
"""


@pytest.fixture
def mole(tmp_path):
    folder = tmp_path / "mole"
    folder.mkdir()
    (folder / "pystk_actor.py").write_text(GROUND_AGENT)
    return folder


def zipped(folder):
    target = folder.parent / "mole.zip"
    with zipfile.ZipFile(target, "w") as archive:
        archive.write(folder / "pystk_actor.py", "mole/pystk_actor.py")
    return target


@pytest.mark.slow
@pytest.mark.parametrize("inline", [False, True])
def test_agents_request_the_ground_with_env_name(mole, inline):
    sources = [
        str(mole),
        str(zipped(mole)),
        str(shutil.copy(mole / "pystk_actor.py", mole / "m.py")),
    ]
    result = run_race(
        [*sources, "heuristic", "ai"],
        track="lighthouse",
        seed=1,
        max_steps=10,
        inline=inline,
        error_handling="raise",
    )
    assert [row.num_errors for row in result.agents] == [0] * 5
    assert [find_driver(source).extras for source in sources] == [{"ground"}] * 3


def test_agents_on_servers_can_request_the_ground(mole):
    with (
        server_thread([find_driver(str(mole))]) as server,
        RemoteDriverGroup([server.address]) as group,
    ):
        assert [driver.extras for driver in group.drivers] == [{"ground"}]
        result = run_race(
            [*group.drivers, "ai"], track="lighthouse", seed=1, max_steps=10, error_handling="raise"
        )
    assert [row.num_errors for row in result.agents] == [0, 0]


@pytest.mark.parametrize(
    ("line", "env_name"),
    [
        ('env_name = "supertuxkart/ground-v0"', "supertuxkart/ground-v0"),
        ("env_name: str = 'supertuxkart/simple-v0'  # mine", "supertuxkart/simple-v0"),
        ("env_name = (\n    'ground',  # that\n    {'size': 3},\n)\n", ("ground", {"size": 3})),
        ("env_name = 'ground' if ME else 'full'", ""),
        ("env_name = " + "(" * 3000, ""),
        ('    env_name = "supertuxkart/ground-v0"', ""),
    ],
)
def test_env_name_is_read_without_running_the_module(tmp_path, line, env_name):
    (tmp_path / "pystk_actor.py").write_text(f"raise SystemExit\n{line}\n")
    assert declared(find_files(str(tmp_path)), "env_name") == env_name


def test_env_name_of_shipped_drivers_is_found_from_any_folder(tmp_path, monkeypatch):
    home = Path(stkzoo.__file__).parent.parent
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [p for p in sys.path if Path(p).resolve() != home])
    for name in ("heuristic", "pretrained.scout"):
        files = find_files(f"stkzoo.agents.{name}")
        assert declared(files, "env_name") == "supertuxkart/full-v0"


def test_an_agent_without_a_literal_env_name_gets_an_error(mole):
    code = (mole / "pystk_actor.py").read_text()
    hidden = code.replace('"supertuxkart/ground-v0"', '"supertuxkart/" + "ground-v0"')
    (mole / "pystk_actor.py").write_text(hidden)
    with pytest.raises(
        AgentError, match="write in an agent's module env_name = 'supertuxkart/ground-v0'"
    ):
        run_race([str(mole)], track="lighthouse", max_steps=5, error_handling="raise")
