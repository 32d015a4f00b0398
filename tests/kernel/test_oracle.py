"""Each name of the kernel has the results of its NumPy implementation in ``tests/oracle``."""

from __future__ import annotations

import contextlib
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stkzoo import RaceVectorEnv, kernel, race_v0
from stkzoo.config import AgentSpec
from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.kernel import ActionReader, join_rows
from stkzoo.mdp import rewards
from stkzoo.mdp.spaces import STANDING_SIZE, extras_of, kart_action_space
from stkzoo.names import AttachmentType, ItemType, PowerupType
from stkzoo.views import VIEWS as ALL_VIEWS
from stkzoo.views import base_space, find_view, full_with
from stkzoo.views.agent_chain import AgentChain
from stkzoo.views.chains import RecordsObserver
from stkzoo.views.plan import Seats, ViewPlan
from stkzoo.wrappers import ConstantSizedObservations, FlattenerWrapper, PolarObservations
from stkzoo.wrappers.control import CarAction
from stkzoo.wrappers.racing import SIZE, racing_features
from stkzoo.wrappers.racing.features import KERNEL_TABLES, STEP
from stkzoo.wrappers.racing.surroundings import NUM_POINTS, RoadObserver
from tests import oracle
from tests.support.kernel_users import replaced_kernel
from tests.support.views import MECHANISMS, marked

TRACKS = ["lighthouse", "cocoa_temple", "olivermath"]
#: The ground is slow in NumPy, and most of all on tracks with many triangles. This one has few.
TRACK_OF_GROUND = "olivermath"


def masked(env):
    sizes = {"state_items": 3, "state_karts": 4, "state_paths": 2}
    return FlattenerWrapper(ConstantSizedObservations(env, add_mask=True, **sizes))


def masked_dict(env):
    return PolarObservations(ConstantSizedObservations(env, add_mask=True, state_karts=1))


def polar_lists(env):
    return PolarObservations(env)


def flat_actions_only(env):
    return FlattenerWrapper(env, flatten_observations=False)


VIEWS = list(ALL_VIEWS)


MOVING = [
    full_with(["motion"]),
    ("flattened", {"karts_motion": True, "state_karts": 2}),
]


CHAINS = [*VIEWS, masked, masked_dict, polar_lists, flat_actions_only, *MOVING]


RACES = [
    (view, TRACK_OF_GROUND if view == "ground" else track)
    for view, track in zip(CHAINS, itertools.cycle(TRACKS), strict=False)
]
#: Chains with observations of variable size.
LISTS = ["full", "ground", polar_lists, flat_actions_only, MOVING[0]]


def assert_close(ours, theirs, path=""):
    assert type(ours) is type(theirs), path
    if isinstance(ours, dict):
        assert list(ours) == list(theirs), path
        for key, value in ours.items():
            assert_close(value, theirs[key], f"{path}/{key}")
    elif isinstance(ours, (tuple, list)):
        assert len(ours) == len(theirs), path
        for number, (own, other) in enumerate(zip(ours, theirs, strict=True)):
            assert_close(own, other, f"{path}[{number}]")
    elif isinstance(ours, np.ndarray):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape), path
        np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=2e-5, err_msg=path)
    else:
        assert ours == theirs, path


def assert_owned(observations):
    """Asserts that an agent can write into its observation."""
    for observation in observations.values():
        parts = observation if isinstance(observation, dict) else {"": observation}
        for key, value in parts.items():
            rows = value if isinstance(value, tuple) else (value,)
            for row in rows:
                if isinstance(row, np.ndarray):
                    assert row.flags.writeable, key


@pytest.fixture
def numpy_only(monkeypatch):
    """Returns a function that makes all later objects use the oracle."""
    with contextlib.ExitStack() as stack:
        replacements = {name: getattr(oracle, name) for name in oracle.__all__}
        yield lambda: stack.enter_context(replaced_kernel(monkeypatch, replacements))


def test_every_name_is_compared():
    stub = Path(kernel.__file__).with_name("_kernel.pyi").read_text()
    names = re.findall(r"^(?:class|def) (\w+)", stub, re.M)
    assert sorted(names) == sorted([*oracle.__all__, "GameStepper"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "track"),
    marked(RACES, [race for race in RACES if race[0] in (*MECHANISMS, "ground", masked_dict)]),
    ids=lambda view: getattr(view, "__name__", str(view)),
)
def test_a_race_is_the_same_with_and_without_the_kernel(view, track, numpy_only):
    settings = {"num_kart": 4, "agents": 3, "track": track, "view": view, "max_cycles": 40}
    settings |= {"events": True, "end_when_stuck": 1.0}
    with_kernel = race_v0.parallel_env(**settings)
    first = with_kernel.reset(seed=3)
    for space in with_kernel.action_spaces.values():
        space.seed(3)
    actions, steps = [], []
    for _ in range(12):
        actions.append({a: with_kernel.action_space(a).sample() for a in with_kernel.agents})
        steps.append(with_kernel.step(actions[-1]))
    assert with_kernel.live_race.chains._latest_roster.walked == ()
    with_kernel.close()

    numpy_only()
    without = race_v0.parallel_env(**settings)
    assert_close(first[0], without.reset(seed=3)[0])
    for action, step in zip(actions, steps, strict=True):
        assert_owned(step[0])
        observations, *rest = without.step(action)
        assert_close(step[0], observations)
        assert list(step[1:]) == rest
    without.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "track"),
    marked(
        [race for race in RACES if race[0] not in LISTS],
        [race for race in RACES if race[0] in ("simple", "masked_discrete", "contest")],
    ),
    ids=lambda view: getattr(view, "__name__", str(view)),
)
def test_rows_are_the_same_with_and_without_the_kernel(view, track, numpy_only):
    settings = {"num_kart": 4, "agents": 3, "track": track, "view": view, "max_cycles": 8}
    settings |= {"events": True, "prefetch": False}

    def trace():
        with contextlib.closing(RaceVectorEnv(2, **settings)) as envs:
            assert envs.races[0].live_race.chains.has_rows
            results = [envs.reset(seed=3)]
            envs.action_space.seed(3)
            actions = (envs.action_space.sample() for _ in range(12))
            return [*results, *map(envs.step, actions)]

    with_kernel = trace()
    numpy_only()
    for ours, theirs in zip(with_kernel, trace(), strict=True):
        assert_close(ours[0], theirs[0])
        for own, other in zip(ours[1:], theirs[1:], strict=True):
            if isinstance(own, dict):
                finals = [list(infos.pop("final_obs", ())) for infos in (own, other)]
                assert_close(*finals)
            np.testing.assert_equal(own, other)


@pytest.mark.parametrize("lag", [0.0, 0.15])
@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("steering", ["steering_angle", "steering_speed"])
@pytest.mark.parametrize("longitudinal", ["speed", "accl"])
def test_the_car_controller_matches_its_oracle(longitudinal, steering, normalize, lag, monkeypatch):
    car = CarAction((longitudinal, steering), {"T_steer": lag}, normalize)
    controller = car.new_controller()
    with replaced_kernel(monkeypatch, {"CarController": oracle.CarController}):
        other = car.new_controller()
    random, count = np.random.default_rng(0), 40
    states = np.zeros((count, 3))
    karts, where = np.zeros(count, KART_DTYPE), np.arange(count)
    for step_size in random.choice([0.05, 0.1, 0.2], 30).tolist():
        states[:, 2] = step_size
        karts["velocity_lc"][:, 2] = random.choice([0, 0.2, 3, 5.2, 12, 26, -1, -4], count)
        karts["velocity_lc"][:, 2] += random.choice([0, 0.3], count) * random.normal(size=count)
        karts["max_steer_angle"] = random.choice([0, 0.1, 0.4], count)
        data = Snapshot.of(np.zeros((), HEADER_DTYPE), karts, np.zeros(0, ITEM_DTYPE)).data
        rows = np.zeros((count, 7), np.float32)
        asked = random.uniform(car.space.low, car.space.high, (count, 2)).astype(np.float32)
        rows[:, 1], rows[:, 0] = asked.T
        other_rows, other_states = rows.copy(), states.copy()
        other.drive(other_rows, where, data, where, other_states, where)
        speed, most = karts["velocity_lc"][:, 2], karts["max_steer_angle"]
        controls, memory = car.controls(asked, speed, most, states[:, :2], step_size)
        controller.drive(rows, where, data, where, states, where)
        assert rows.tolist() == other_rows.tolist()
        assert rows[:, :3].tolist() == controls.tolist()
        assert states.tolist() == other_states.tolist()
        assert states[:, :2].tolist() == memory.tolist()


SIZES = {"state_items": 3, "state_karts": 1, "state_paths": 7, "add_mask": True}


@pytest.mark.slow
@pytest.mark.parametrize(
    "view",
    [
        *marked(VIEWS, (*MECHANISMS, "masked_discrete", "flattened_control")),
        ("flattened", SIZES),
        ("box_discrete", SIZES | {"steer_steps": 3}),
        *MOVING,
    ],
)
def test_a_compiled_view_matches_its_wrappers(view):
    """Compares the view in one race, made by the kernel and by the individual wrappers."""
    settings = {"num_kart": 3, "track": "lighthouse", "max_cycles": 40}
    seen = base_space(find_view(view))
    base = full_with(extras_of(seen))
    with race_v0.parallel_env(view={0: view, 1: base, 2: base}, **settings) as env:
        chain = AgentChain("kart_0", seen, kart_action_space(), find_view(view))
        full = RecordsObserver(ViewPlan(seen))
        observations, _ = env.reset(seed=3)
        for agent, space in env.action_spaces.items():
            space.seed(int(agent[-1]))
        for _ in range(20):
            seen = full.observe(env.live_race.episode, np.array([0]))
            assert_close(observations["kart_0"], chain.reset(seen[0], {})[0])
            observations = env.step({a: env.action_space(a).sample() for a in env.agents})[0]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_the_racing_view_is_the_same_for_random_snapshots(seed):
    """Karts and items are anywhere and in any state, and many of them share a place."""
    random = np.random.default_rng(seed)
    karts, items = np.zeros(9, KART_DTYPE), np.zeros(12, ITEM_DTYPE)
    for things in (karts, items):
        places = random.normal(size=(len(things), 3)) * random.choice([2, 10, 50])
        things["location"] = random.choice(places, len(things))
    turns = random.normal(size=(9, 4))
    karts["rotation"] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    karts["position"], karts["control"] = random.permutation(9) + 1, random.normal(size=(9, 7))
    motion = "velocity", "overall_distance", "velocity_lc", "max_steer_angle", "skeed_factor"
    for key in (*motion, "energy", "shield_time"):
        karts[key] = random.normal(size=karts[key].shape) * 40
    for key, kind in (("powerup_type", PowerupType), ("attachment_type", AttachmentType)):
        karts[key] = random.choice(list(kind), 9)
    karts["powerup_num"], karts["jumping"] = random.integers(0, 20, 9), random.integers(0, 2, 9)
    items["type"] = random.choice(list(ItemType), 12)
    snapshot = Snapshot.of(np.zeros((), HEADER_DTYPE), karts, items)
    observer, who = RoadObserver.__new__(RoadObserver), np.arange(9)
    observer.road, (seen, twin) = road_of(random), np.empty((2, 9, SIZE), np.float32)
    observer.observe_into(snapshot, who, who, seen)
    oracle.observe_racing(observer.road, KERNEL_TABLES, snapshot.data, who, who, twin)
    np.testing.assert_allclose(seen, twin, atol=2e-4)
    around = observer.surroundings(snapshot, who)
    np.testing.assert_array_equal(racing_features(around), seen)
    wide, twin = np.zeros((2, 9, 3 + STANDING_SIZE), np.float32)
    race = snapshot.data, random.integers(-1, 2, 9), 50.0, who, random.permutation(9)
    kernel.observe_standing(*race, wide, 2)
    oracle.observe_standing(*race, twin, 2)
    np.testing.assert_allclose(wide, twin, atol=1e-4)


def road_of(random):
    """Returns a road with a winding line and one segment, which may have length 0."""
    steps = random.normal([0.0, 0.0, 2.0, 0.0], 0.6, (1, NUM_POINTS, 4))
    starts = random.normal(size=(1, 3)).astype("f4") * 5
    along = (random.normal(size=(1, 3)) * random.choice([0, 1, 10, 30])).astype("f4")
    return np.cumsum(steps, axis=1).astype("f4"), starts, along, STEP


@pytest.mark.slow
@pytest.mark.parametrize(
    "reward", ["race", "reference", "placement", {"place": 0.5, "gained": rewards.overtaking}]
)
def test_rewards_and_infos_are_the_same_to_the_finish(reward, numpy_only):
    """Runs one lap of the game's AI, in which karts finish and leave."""

    def race():

        agents = [AgentSpec(use_ai=True) for _ in range(3)]
        env = race_v0.parallel_env(
            agents=agents, num_kart=3, track="olivermath", reward=reward, max_cycles=None
        )
        env.reset(seed=1)
        while env.agents:
            yield env.step({})[1:]
        env.close()

    with_kernel = list(race())
    numpy_only()
    assert with_kernel == list(race())


def fuzzed(random, value):
    """Returns a value that is close to a valid one."""
    if isinstance(value, dict):
        key = random.choice(list(value))
        return {**value, key: fuzzed(random, value[key])}
    array = np.asarray(value)
    choices = [
        array.astype(random.choice(["f8", "f4", "i8", "i4", "i2", "u1", "?"])),
        array.tolist(),
        array[..., None],
        array[::-1] if array.ndim else array,
        np.repeat(array, 2)[::2].reshape(array.shape),
        array + random.choice([1e-7, 1e-3, 1, -1, np.inf, np.nan]),
        array.reshape(-1)[:1],
        value,
    ]
    return choices[random.integers(len(choices))]


@pytest.mark.parametrize(
    "view", marked([view for view in VIEWS if "control" not in view], MECHANISMS)
)
def test_actions_are_read_as_by_the_wrappers(view):
    """The oracle and the wrappers give the same controls for accepted actions."""
    env = race_v0.parallel_env(num_kart=1, track="lighthouse", view=view)
    chains, space = env.live_race.chains, env.action_space("kart_0")
    seen, acted = base_space(ALL_VIEWS[view]), kart_action_space()
    chain = AgentChain("kart_0", seen, acted, ALL_VIEWS[view])
    space.seed(0)
    random = np.random.default_rng(0)
    plan = chains._plans["kart_0"]
    names = () if set(plan.leaves) == {""} else tuple(plan.leaves)
    twin = oracle.ActionReader(names, tuple(plan.leaves.values()))
    place = np.zeros(1, np.intp)
    (group,) = chains._roster(Seats(("kart_0",), place, place, 1, place)).groups
    num_taken = 0
    for _ in range(1000):
        actions = {"kart_0": fuzzed(random, space.sample())}
        ours, theirs = np.zeros((2, 1, 7), np.float32)
        if not group.kernel.reader.read(actions, group.seats.agents, group.seats.rows, ours):
            continue
        num_taken += 1
        assert twin.read(actions, group.seats.agents, group.seats.rows, theirs), actions
        assert ours.tolist() == theirs.tolist(), actions
        base = chain.begin_step(chain.read_action(actions["kart_0"]))
        assert ours[0].tolist() == [np.float32(np.ravel(base[key])[0]) for key in CONTROLS]
    assert num_taken > 100


def test_batches_of_actions_match_the_oracle():
    random = np.random.default_rng(0)
    table = random.normal(size=(4, 2)).astype(np.float32)
    leaves = (
        ((-1.0, 1.0, False, 0, None),),
        ((0.0, 3.0, True, 1, table), (0.0, 1.0, True, 3, None)),
    )
    readers = [made(("a", "b"), leaves) for made in (ActionReader, oracle.ActionReader)]
    slots, rows, num_taken = np.array([4, 0, 2]), np.array([1, 0, 3]), 0
    for number in range(500):
        good = {"a": random.uniform(-1, 1, (5, 1)), "b": random.integers(0, 2, (5, 2))}
        if number % 2:  # columns of wider arrays, and arrays in another order
            wide = random.uniform(-1, 1, (5, 3))
            good = {"a": wide[::-1, 1:2], "b": np.asfortranarray(good["b"])}
        batch = fuzzed(random, good) if random.random() < 0.5 else good
        ours, theirs = np.ones((2, 5, 7), np.float32)
        is_read = readers[0].read(batch, slots, rows, ours, 5)
        assert is_read or batch is not good
        if is_read:
            num_taken += 1
            assert readers[1].read(batch, slots, rows, theirs, 5), batch
            assert ours.tolist() == theirs.tolist()
            assert (ours[[2, 4]] == 1).all()
    assert 250 < num_taken < 500


def twin_of(track):
    """Returns the oracle's form of the same graph."""
    begins = np.cumsum([0, *map(len, track.successors)]).astype(np.intp)
    ends = np.array([node for nodes in track.successors for node in nodes], np.intp)
    arrays = track.path_nodes, track.path_width, track.path_distance, begins, ends
    return oracle.TrackGraph(*arrays, track.length)


@settings(max_examples=200, deadline=None)
@given(
    st.integers(1, 12).flatmap(
        lambda n: st.lists(st.lists(st.integers(0, n - 1), max_size=3), min_size=n, max_size=n)
    )
)
def test_the_order_ahead_is_the_same_on_any_graph(successors):
    count = len(successors)
    track = TrackMap(
        length=float(3 * count),
        path_nodes=np.zeros((count, 2, 3), np.float32),
        path_width=np.ones((count, 1), np.float32),
        path_distance=np.arange(2 * count, dtype=np.float32).reshape(count, 2),
        successors=successors,
    )
    for node in range(count):
        assert track.graph.ahead(node).tolist() == twin_of(track).ahead(node).tolist()


@pytest.mark.parametrize(
    "parts",
    [
        (),
        (np.ones(3, "f4"), np.zeros(3, "f4")),
        (np.ones(3, "f4"), np.zeros(2, "f4")),
        (np.ones(3, "f4"), np.zeros(3, "f8")),
        (np.ones(3, "f4"), 7),
        (np.ones((3, 2), "f4"), np.ones((2, 3), "f4").T),
        (np.zeros(0), np.zeros(0)),
    ],
)
def test_joined_rows_match_the_oracle(parts):
    assert join_rows(parts) == oracle.join_rows(parts)
