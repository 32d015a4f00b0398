"""Each name of the kernel matches its NumPy reference implementation."""

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
from stkzoo.engine.track import TrackMap, decode_track
from stkzoo.errors import ActionError
from stkzoo.kernel import (
    ActionReader,
    EventCounter,
    KartObserver,
    RacingObserver,
    StepScorer,
    TrackGraph,
    join_rows,
)
from stkzoo.mdp.spaces import extras_of, kart_action_space, kart_observation_space
from stkzoo.names import AttachmentType, ItemType, PowerupType
from stkzoo.tracks import SPLITS
from stkzoo.views import VIEWS as ALL_VIEWS
from stkzoo.views import AgentChain, base_space, find_view, full_with
from stkzoo.views.plan import Seats
from stkzoo.wrappers import ConstantSizedObservations, FlattenerWrapper, PolarObservations
from stkzoo.wrappers.control import CarAction
from stkzoo.wrappers.racing import SIZE, BatchedRacingView, RoadTable, racing_features
from stkzoo.wrappers.racing.features import KERNEL_TABLES
from stkzoo.wrappers.racing.road import LOOKS, NUM_POINTS
from stkzoo.wrappers.racing.wrapper import _writer, racing_view_of
from tests import oracle
from tests.oracle.racing_observer import own_arrays

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

    def turn_off():
        for user, names in USERS.items():
            for name in names:
                monkeypatch.setattr(f"stkzoo.{user}.{name}", getattr(oracle, name))
        decode_track.cache_clear()
        racing_view_of.cache_clear()
        _writer.cache_clear()

    yield turn_off
    decode_track.cache_clear()
    racing_view_of.cache_clear()
    _writer.cache_clear()


#: The modules that use the kernel's names.
USERS = {
    "engine.track": ["TrackGraph"],
    "env.episode": ["StepScorer"],
    "mdp.events": ["EventCounter"],
    "mdp.rewards": ["reward_term"],
    "drivers.messages": ["join_rows"],
    "mdp.observations": ["KartObserver"],
    "views.plan": ["ActionReader", "KartObserver"],
    "wrappers.marl.masks": ["action_mask"],
    "wrappers.observations": ["to_polar"],
    "wrappers.control.car_action": ["CarController"],
    "wrappers.racing.road": ["trace_roads"],
    "wrappers.racing.surroundings": ["look_along", "stack_vectors"],
    "wrappers.racing.wrapper": ["RacingObserver"],
    "agents.pretrained.mlp": ["Mlp"],
    "agents.pretrained.policy": ["Mlp"],
}


def test_every_name_is_compared():
    stub = Path(kernel.__file__).with_name("_kernel.pyi").read_text()
    names = re.findall(r"^(?:class|def) (\w+)", stub, re.M)
    assert sorted(names) == sorted([*oracle.__all__, "GameStepper", "layouts"])
    assert {name for names in USERS.values() for name in names} == {*oracle.__all__}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("view", "track"),
    [
        (view, TRACK_OF_GROUND if view == "ground" else track)
        for view, track in zip(CHAINS, itertools.cycle(TRACKS), strict=False)
    ],
    ids=lambda view: getattr(view, "__name__", view),
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
    assert with_kernel._chains._latest_roster.walked == ()
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
    [
        (view, track)
        for view, track in zip(CHAINS, itertools.cycle(TRACKS), strict=False)
        if view not in LISTS
    ],
    ids=lambda view: getattr(view, "__name__", str(view)),
)
def test_rows_are_the_same_with_and_without_the_kernel(view, track, numpy_only):
    settings = {"num_kart": 4, "agents": 3, "track": track, "view": view, "max_cycles": 8}
    settings |= {"events": True, "prefetch": False}

    def trace():
        with contextlib.closing(RaceVectorEnv(2, **settings)) as envs:
            assert envs._has_rows
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
@pytest.mark.parametrize("normalize_act", [False, True])
@pytest.mark.parametrize("steering", ["steering_angle", "steering_speed"])
@pytest.mark.parametrize("longitudinal", ["speed", "accl"])
def test_the_car_controller_matches_its_reference_implementation(
    longitudinal, steering, normalize_act, lag
):
    car = CarAction((longitudinal, steering), {"T_steer": lag}, normalize=normalize_act)
    controller = car.new_controller(CONTROLS)
    twin = oracle.CarController(car.act, (), (), None, (0, 1, 2), 7)
    random, count = np.random.default_rng(0), 40
    ours, theirs = (np.zeros((count, 3)) for _ in range(2))
    ours[:, 2] = theirs[:, 2] = random.choice([0.05, 0.1, 0.2], count)
    karts, where = np.zeros(count, KART_DTYPE), np.arange(count)
    for _ in range(30):
        karts["velocity_lc"][:, 2] = random.choice([0, 0.2, 3, 5.2, 12, 26, -1, -4], count)
        karts["velocity_lc"][:, 2] += random.choice([0, 0.3], count) * random.normal(size=count)
        karts["max_steer_angle"] = random.choice([0, 0.1, 0.4], count)
        data = Snapshot.of(np.zeros((), HEADER_DTYPE), karts, np.zeros(0, ITEM_DTYPE)).data
        rows = np.zeros((count, 7), np.float32)
        asked = random.uniform(car.space.low, car.space.high, (count, 2))
        rows[:, 1], rows[:, 0] = asked.astype(np.float32).T
        told = rows.copy()
        controller.drive(rows, where, data, where, ours, where)
        twin.drive(told, where, data, where, theirs, where)
        assert rows.tolist() == told.tolist()
        assert ours.tolist() == theirs.tolist()


def test_a_controller_checks_its_arguments():
    controller = CarAction().new_controller(CONTROLS)
    snapshot = Snapshot.of(
        np.zeros((), HEADER_DTYPE), np.zeros(1, KART_DTYPE), np.zeros(0, ITEM_DTYPE)
    )
    one, two = np.zeros(1, np.intp), np.zeros(2, np.intp)
    rows, states = np.zeros((1, 7), np.float32), np.ones((1, 3))
    controller.drive(rows, one, snapshot.data, one, states, one)
    for wrong in (0, 2, 4):
        arguments = [one, snapshot.data, one, states, one]
        arguments[wrong] = one + 1
        with pytest.raises(IndexError, match="a row, kart or state index"):
            controller.drive(rows, *arguments)
    with pytest.raises(ValueError, match="1 rows, 2 karts"):
        controller.drive(rows, one, snapshot.data, two, states, one)


SIZES = {"state_items": 3, "state_karts": 1, "state_paths": 7, "add_mask": True}


@pytest.mark.slow
@pytest.mark.parametrize(
    "view", [*VIEWS, ("flattened", SIZES), ("box_discrete", SIZES | {"steer_steps": 3}), *MOVING]
)
def test_a_compiled_view_matches_its_wrappers(view):
    """Compares the view in one race, made by the kernel and by the individual wrappers."""
    settings = {"num_kart": 3, "track": "lighthouse", "max_cycles": 40}
    seen = base_space(find_view(view))
    base = full_with(extras_of(seen))
    with race_v0.parallel_env(view={0: view, 1: base, 2: base}, **settings) as env:
        chain = AgentChain("kart_0", seen, kart_action_space(), find_view(view))
        observations, _ = env.reset(seed=3)
        for agent, space in env.action_spaces.items():
            space.seed(int(agent[-1]))
        for _ in range(20):
            seen = env._chains._kernels[full_of(env)][0].observe(env._episode, np.array([0]))
            assert_close(observations["kart_0"], chain.observe(seen[0]))
            observations = env.step({a: env.action_space(a).sample() for a in env.agents})[0]


def full_of(env):
    """Returns the identity of an agent's plan for the full view."""
    return env._chains._identities["kart_1"]


@pytest.mark.parametrize("track", TRACKS)
def test_the_racing_view_is_the_same_with_and_without_the_kernel(track):
    with race_v0.parallel_env(num_kart=6, track=track, view="racing") as env:
        env.reset(seed=3)
        for agent, space in env.action_spaces.items():
            space.seed(int(agent[-1]))
        view, who = BatchedRacingView([RoadTable(env.track_map)]), np.array([5, 0, 3])
        for _ in range(80):
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            seen = view.observe([env.snapshot], [0], [who])
            made, surroundings = seen_by_twin(env.snapshot, RoadTable(env.track_map), who)
            assert_close(seen, made)
            own, around = view.surroundings([env.snapshot], [0], [who])
            assert_close(around.road, surroundings[0])
            assert (view.road([env.snapshot], [0], [who], LOOKS) == around.road).all()
            assert_close(racing_features(own, around), made)
    assert seen.any(axis=0).sum() > 80


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
    for key in ("velocity_lc", "energy", "shield_time", "max_steer_angle", "skeed_factor"):
        karts[key] = random.normal(size=karts[key].shape) * 40
    for key, kind in (("powerup_type", PowerupType), ("attachment_type", AttachmentType)):
        karts[key] = random.choice(list(kind), 9)
    karts["powerup_num"], karts["jumping"] = random.integers(0, 20, 9), random.integers(0, 2, 9)
    items["type"] = random.choice(list(ItemType), 12)
    snapshot = Snapshot.of(np.zeros((), HEADER_DTYPE), karts, items)
    table, who = road_of(random), np.arange(9)
    view = BatchedRacingView([table])
    seen = view.observe([snapshot], [0], [who])
    np.testing.assert_allclose(seen, seen_by_twin(snapshot, table, who)[0], atol=2e-4)
    own, around = view.surroundings([snapshot], [0], [who])
    np.testing.assert_array_equal(racing_features(own, around), seen)
    np.testing.assert_array_equal(view.road([snapshot], [0], [who], LOOKS), around.road)


def seen_by_twin(snapshot, table, who):
    """Returns the view and the surroundings of some karts from the reference implementation."""
    roads = ((table.lines, table.starts, table.along),)
    twin = oracle.RacingObserver(roads, *KERNEL_TABLES)
    view = np.empty((len(who), SIZE), np.float32)
    twin.observe(snapshot.data, 0, who, view)
    counts = ((len(LOOKS), 4), (len(snapshot.karts), 3), (len(snapshot.items), 3))
    around = [np.empty((len(who), *shape), np.float32) for shape in counts]
    types = np.empty((len(who), len(snapshot.items)), np.int64)
    twin.look(snapshot.data, 0, who, LOOKS, *own_arrays(len(who)), (*around, types))
    return view, (*around, types)


def road_of(random):
    """Returns a road table with a winding line and one segment, which may have length 0."""
    road = RoadTable.__new__(RoadTable)
    road.length = 100.0
    steps = random.normal([0.0, 0.0, 2.0, 0.0], 0.6, (1, NUM_POINTS, 4))
    road.lines = np.cumsum(steps, axis=1).astype("f4")
    road.starts = random.normal(size=(1, 3)).astype("f4") * 5
    road.along = (random.normal(size=(1, 3)) * random.choice([0, 1, 10, 30])).astype("f4")
    return road


@pytest.mark.slow
@pytest.mark.parametrize("reward", ["race", "reference", "placement", {"place": 0.5, "time": 3}])
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


@pytest.mark.parametrize(
    "keep",
    [
        lambda rows: rows,
        lambda rows: rows[-1],
        lambda rows: rows[0][1:],
        lambda rows: rows[0].base,
        lambda rows: memoryview(rows[1]),
    ],
    ids=["tuple", "row", "part of a row", "block", "memoryview"],
)
@pytest.mark.parametrize("key", ["paths_start", "paths_width", "items_position"])
def test_kept_observations_never_change(keep, key):
    with contextlib.closing(race_v0.parallel_env(num_kart=2, track="lighthouse")) as env:
        observations, _ = env.reset(seed=3)
        kept, copies = [], []
        for _ in range(12):
            kept.append(keep(observations["kart_0"][key]))
            copies.append(np.array(kept[-1]))
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            observations = env.step(actions)[0]
        for part, copy in zip(kept, copies, strict=True):
            np.testing.assert_array_equal(part, copy)
        assert not np.shares_memory(observations["kart_0"][key][0], observations["kart_1"][key][0])


def reshape(row):
    row.shape = (1, 3)


def make_read_only(row):
    row.flags.writeable = False


def swap_bytes(row):
    row.dtype = row.dtype.newbyteorder()


@pytest.mark.filterwarnings("ignore:Setting the:DeprecationWarning")  # since NumPy 2.5
@pytest.mark.parametrize("modify", [reshape, make_read_only, swap_bytes])
def test_modified_rows_are_not_reused(modify):
    with contextlib.closing(race_v0.parallel_env(num_kart=1, track="lighthouse")) as env:
        observations, _ = env.reset(seed=3)
        for _ in range(12):
            rows = observations["kart_0"]["paths_start"]
            assert {row.shape for row in rows} == {(3,)}
            assert all(row.flags.writeable and row.dtype.isnative for row in rows)
            modify(rows[0])
            del rows
            observations = env.step({"kart_0": env.action_space("kart_0").sample()})[0]


def test_custom_wrappers_and_terms_work_without_the_kernel():
    class Mine(PolarObservations):
        pass

    env = race_v0.parallel_env(
        num_kart=2, track="lighthouse", view={0: Mine}, reward={"mine": lambda step: step.distance}
    )
    env.reset(seed=0)
    env.step({a: env.action_space(a).sample() for a in env.agents})
    assert env._chains._latest_roster.walked == ("kart_0",)
    env.close()


@pytest.mark.parametrize("view", VIEWS)
def test_bad_actions_are_refused(view):
    env = race_v0.parallel_env(num_kart=2, track="lighthouse", view=view)
    env.reset(seed=0)
    good = {a: env.action_space(a).sample() for a in env.agents}
    for bad in (None, "left", 10**30, -1.5, float("nan"), {}, [], {"steer": 3}, np.zeros(11)):
        with pytest.raises(ActionError):
            env.step({**good, "kart_1": bad})
    env.step(good)
    env.close()


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


@pytest.mark.parametrize("view", [view for view in VIEWS if "control" not in view])
def test_actions_are_read_as_by_the_wrappers(view):
    """The reference implementation and the wrappers give the same controls for accepted actions."""
    env = race_v0.parallel_env(num_kart=1, track="lighthouse", view=view)
    chains, space = env._chains, env.action_space("kart_0")
    chain = AgentChain("kart_0", *bare_spaces(view), ALL_VIEWS[view])
    space.seed(0)
    random = np.random.default_rng(0)
    plan = chains._plans["kart_0"]
    names = () if set(plan.leaves) == {""} else tuple(plan.leaves)
    twin = oracle.ActionReader(names, tuple(plan.leaves.values()), 7)
    place = np.zeros(1, np.intp)
    (group,) = chains._roster(Seats(("kart_0",), place, place, 1)).groups
    num_taken = 0
    for _ in range(1000):
        actions = {"kart_0": fuzzed(random, space.sample())}
        ours, theirs = np.zeros((2, 1, 7), np.float32)
        if not group.reader.read(actions, group.agents, group.rows, ours):
            continue
        num_taken += 1
        assert twin.read(actions, group.agents, group.rows, theirs), actions
        assert ours.tolist() == theirs.tolist(), actions
        base = chain.act(chain.read_action(actions["kart_0"]))
        assert ours[0].tolist() == [np.float32(np.ravel(base[key])[0]) for key in CONTROLS]
    assert num_taken > 100


def bare_spaces(view):
    return kart_observation_space(extras=[view] if view == "ground" else []), kart_action_space()


def test_batches_of_actions_match_the_reference_implementation():
    random = np.random.default_rng(0)
    table = random.normal(size=(4, 2)).astype(np.float32)
    leaves = (
        ((-1.0, 1.0, False, 0, None),),
        ((0.0, 3.0, True, 1, table), (0.0, 1.0, True, 3, None)),
    )
    readers = [made(("a", "b"), leaves, 4) for made in (ActionReader, oracle.ActionReader)]
    slots, rows, num_taken = np.array([4, 0, 2]), np.array([1, 0, 3]), 0
    for _ in range(500):
        good = {"a": random.uniform(-1, 1, (5, 1)), "b": random.integers(0, 2, (5, 2))}
        batch = fuzzed(random, good) if random.random() < 0.5 else good
        ours, theirs = np.ones((2, 5, 4), np.float32)
        is_read = readers[0].read_batch(batch, 5, slots, rows, ours)
        if is_read:
            num_taken += 1
            assert readers[1].read_batch(batch, 5, slots, rows, theirs), batch
            assert ours.tolist() == theirs.tolist()
            assert (ours[[2, 4]] == 1).all()
    assert 250 < num_taken < 500


def track_of(successors, length=20.0, count=None, kind=TrackGraph):
    begins = np.cumsum([0, *map(len, successors)]).astype(np.intp)
    ends = np.array([node for nodes in successors for node in nodes], np.intp)
    count = len(successors) if count is None else count
    sizes = (6, 1, 2)
    arrays = (np.arange(size * count, dtype=np.float32) for size in sizes)
    return kind(*arrays, begins, ends, length)


#: Arguments of a ``StepScorer`` with one agent.
ALONE = (
    ("kart_0",),
    np.zeros(1, np.intp),
    np.zeros(1, np.intp),
    np.zeros((1, 1)),
    np.zeros((1, 1)),
    ("position", "distance", "lap", "finish_time", "now", "sum", "return", "length"),
    20.0,
)


def scorer_of(*, alone=ALONE, rewards=(), events=np.zeros((1, 0))):  # noqa: B008 - read only
    return StepScorer(*alone, rewards, events)


def test_the_kernel_checks_its_arguments():
    numbers = np.zeros(3, np.intp)
    one = np.zeros(1, np.intp)
    snapshot = Snapshot.of(
        np.zeros((), HEADER_DTYPE), np.zeros(1, KART_DTYPE), np.zeros(2, ITEM_DTYPE)
    )
    with pytest.raises(TypeError):
        KartObserver(("energy",)).observe(*[numbers] * 5)
    with pytest.raises(ValueError, match="not a snapshot"):
        KartObserver(("energy",)).observe(track_of([[0]]), 1, ("tux",), snapshot.data[:-1], one)
    with pytest.raises(IndexError, match="kart 1 of 1"):
        KartObserver(("energy",)).observe(track_of([[0]]), 1, ("tux",), snapshot.data, one + 1)
    with pytest.raises(ValueError, match="2 of 1 segments"):
        KartObserver(("energy",)).observe(track_of([[0]]), 2, ("tux",), snapshot.data, one)
    with pytest.raises(ValueError, match="no entry named"):
        KartObserver(("color",))
    with pytest.raises(ValueError, match="a fixed size"):
        KartObserver(("energy",), flat=True)
    with pytest.raises(ValueError, match="table"):
        ActionReader((), (((0.0, 3.0, True, 0, np.zeros((3, 2), "f4")),),), 2)
    with pytest.raises(ValueError, match="beyond the last one"):
        ActionReader((), (((0.0, 1.0, True, 7, None),),), 7)
    for wrong in ([[1]], [[-1]], []):
        with pytest.raises(ValueError, match="do not fit"):
            track_of(wrong)
    road = road_of(np.random.default_rng(0))
    racing = RacingObserver(((road.lines, road.starts, road.along),), *KERNEL_TABLES)
    view = np.zeros((1, SIZE), "f4")
    racing.observe(snapshot.data, 0, one, view)
    with pytest.raises(ValueError, match="165 numbers"):
        racing.observe(snapshot.data, 0, one, view[:, 1:].copy())
    with pytest.raises(IndexError, match="no road 1"):
        racing.observe(snapshot.data, 1, one, view)
    with pytest.raises(IndexError, match="kart 1 of 1"):
        racing.observe(snapshot.data, 0, one + 1, view)
    view.flags.writeable = False
    with pytest.raises(ValueError, match="writeable"):
        racing.observe(snapshot.data, 0, one, view)
    with pytest.raises(ValueError, match="do not fit"):
        RacingObserver(((road.lines[:, 1:].copy(), road.starts[:0], road.along),), *KERNEL_TABLES)
    with pytest.raises(ValueError, match="do not fit"):
        track_of([[0]], count=2)
    with pytest.raises(IndexError):
        track_of([[0]]).ahead(1)


KARTS = Snapshot.of(
    np.zeros((), HEADER_DTYPE), np.zeros(2, KART_DTYPE), np.zeros(2, ITEM_DTYPE)
).data
FIRST, TWO = np.zeros(1, np.intp), np.arange(2)


def observe_into(observer, where, batch, who=TWO):
    kind = TrackGraph if isinstance(observer, KartObserver) else oracle.TrackGraph
    track = track_of([[0]], kind=kind)
    observer.observe_into(track, 1, ("tux", "gnu"), KARTS, who, where, batch)


def test_an_observer_checks_a_batch():
    observer = KartObserver(("kart_type", "energy", "items_type", "items_mask"), items=3)
    batch = {"kart_type": [""] * 4, "energy": np.ones((4, 1), np.float32)}
    batch |= {"items_type": np.ones((4, 3), np.int64), "items_mask": np.ones((4, 3), np.int8)}
    observe_into(observer, np.array([3, 1]), batch)
    assert batch["kart_type"] == ["", "gnu", "", "tux"]
    assert batch["energy"][:, 0].tolist() == [1, 0, 1, 0]
    assert batch["items_mask"][[0, 3]].tolist() == [[1, 1, 1], [1, 1, 0]]
    for where in (np.array([4, 1]), np.array([-1, 1])):
        with pytest.raises(IndexError, match="a row index"):
            observe_into(observer, where, batch)
    with pytest.raises(IndexError, match="kart 2 of 2"):
        observe_into(observer, TWO, batch, TWO + 1)
    with pytest.raises(ValueError, match="1 karts for 2 rows"):
        observe_into(observer, TWO, batch, FIRST)
    fixed = np.ones((4, 1), np.float32)
    fixed.flags.writeable = False
    for wrong, message in (
        ({"energy": fixed}, "writeable"),
        ({"energy": np.ones((4, 2), np.float32)}, "the wrong number of energy"),
        ({"energy": np.ones((), np.float32)}, "the wrong number of energy"),
        ({"energy": np.ones((4, 1))}, "float32"),
        ({"energy": np.ones((4, 1), np.dtype("f4").newbyteorder("S"))}, "native-endian"),
        ({"items_type": np.ones((4, 3), np.float32)}, "int64"),
        ({"items_mask": np.ones((4, 3), np.int8)[::-1]}, "contiguous"),
        ({"kart_type": ()}, "names"),
        ({"kart_type": [""]}, "range"),
    ):
        with pytest.raises((ValueError, TypeError, IndexError), match=message):
            observe_into(observer, np.array([3, 1]), batch | wrong)
    for batch_ in ({}, None, np.ones((4, 1), np.float32)):
        with pytest.raises((ValueError, TypeError), match="batch"):
            observe_into(KartObserver(("energy",)), TWO, batch_)


@pytest.mark.parametrize("name", ["items_type", "paths_start", "action"])
@pytest.mark.parametrize("made", [KartObserver, oracle.KartObserver])
def test_entries_of_variable_size_have_no_rows(made, name):
    with pytest.raises(ValueError, match=f"{name} has no row"):
        made((name,)).observe_into(track_of([[0]]), 1, ("tux",), KARTS, FIRST, FIRST, {name: []})


def test_a_flat_observer_checks_a_batch():
    names, none = ("energy", "jumping"), np.zeros(3, np.bool_)
    flat = KartObserver(names, 0, 0, 0, flat=True, nitro=~none, fire=none)
    batch = {"continuous": np.ones((2, 1), np.float32), "discrete": np.ones((2, 1), np.int64)}
    batch["action_mask"] = np.ones((2, 3), np.int8)
    observe_into(flat, TWO, batch)
    assert not any(part.any() for part in batch.values())
    for key in batch:
        with pytest.raises(ValueError, match=f"no {key}"):
            observe_into(flat, TWO, {name: part for name, part in batch.items() if name != key})
        with pytest.raises(IndexError, match="a row index"):
            observe_into(flat, TWO, batch | {key: batch[key][:1]})
    joined = KartObserver(names, 0, 0, 0, flat=True, joined=np.array([2]))
    vectors = np.ones((2, 3), np.float32)
    observe_into(joined, TWO, vectors)
    assert vectors.tolist() == [[0, 1, 0]] * 2
    for wrong in (vectors[:, 1:].copy(), batch, None, vectors.astype(np.float64)):
        with pytest.raises((ValueError, TypeError)):
            observe_into(joined, TWO, wrong)
    for kind in (KartObserver, oracle.KartObserver):
        with pytest.raises(IndexError, match="choice 0"):
            observe_into(kind(names, 0, 0, 0, flat=True, joined=FIRST), TWO, vectors[:, :1].copy())


def test_racing_rows_are_checked():
    road = road_of(np.random.default_rng(0))
    racing = RacingObserver(((road.lines, road.starts, road.along),), *KERNEL_TABLES)
    views = np.full((3, SIZE), 9, np.float32)
    racing.observe(KARTS, 0, TWO, views, np.array([2, 0]))
    assert (views == 9).all(axis=1).tolist() == [False, True, False]
    with pytest.raises(ValueError, match="2 karts for 1 rows"):
        racing.observe(KARTS, 0, TWO, views, FIRST)
    with pytest.raises(ValueError, match="rows of 165 numbers"):
        racing.observe(KARTS, 0, TWO, views[:, 1:].copy(), TWO)
    for where in (np.array([0, 3]), np.array([-1, 0])):
        with pytest.raises(IndexError, match="a row index"):
            racing.observe(KARTS, 0, TWO, views, where)


def test_a_reader_checks_a_batch():
    reader = ActionReader((), (((0.0, 1.0, True, 0, None),),), 1)
    actions, controls = np.ones(3, np.int64), np.zeros((2, 1), np.float32)
    assert reader.read_batch(actions, 3, TWO, TWO, controls)
    assert not reader.read_batch(actions, 4, TWO, TWO, controls)
    assert not reader.read_batch(np.array(1), 1, FIRST, FIRST, controls)
    assert not reader.read_batch([1, 1, 1], 3, TWO, TWO, controls)
    with pytest.raises(ValueError, match="2 slots for 1 rows"):
        reader.read_batch(actions, 3, TWO, FIRST, controls)
    for slots, where in ((TWO, TWO + 1), (TWO - 1, TWO), (TWO + 2, TWO)):
        with pytest.raises(IndexError, match="slot or row"):
            reader.read_batch(actions, 3, slots, where, controls)


def test_a_counter_checks_its_arguments():
    nodes = np.zeros((1, 2, 3), np.float32)
    memory, counts = np.zeros((1, 9)), np.zeros((1, 10))
    counter = EventCounter(nodes, 0.1, memory, counts)
    header, items = np.zeros((), HEADER_DTYPE), np.zeros(0, ITEM_DTYPE)
    one, two = (Snapshot.of(header, np.zeros(n, KART_DTYPE), items).data for n in (1, 2))
    counter.count(one, one)
    with pytest.raises(ValueError, match="with 2 karts"):
        counter.count(one, two)
    with pytest.raises(ValueError, match="do not fit"):
        EventCounter(nodes, 0.1, memory[:, 1:].copy(), counts)
    with pytest.raises(ValueError, match="do not fit"):
        EventCounter(nodes, 0.1, memory, counts[:, 1:].copy())
    nowhere = np.zeros(1, KART_DTYPE)
    nowhere["node"] = 1
    with pytest.raises(ValueError, match="no segment"):
        counter.count(one, Snapshot.of(header, nowhere, items).data)


@pytest.mark.parametrize(
    "wrong",
    [
        {"alone": (*ALONE[:1], np.zeros(2, np.intp), *ALONE[2:])},
        {"alone": (*ALONE[:2], one_off := np.ones(1, np.intp), *ALONE[3:])},
        {"alone": (*ALONE[:3], np.zeros((1, 2)), *ALONE[4:])},
        {"alone": (*ALONE[:5], ALONE[5][1:], *ALONE[6:])},
        {"rewards": ((("time",), np.ones(2), one_off - 1, one_off - 1),)},
        {"rewards": ((("time",), np.ones(1), one_off, one_off - 1),)},
        {"rewards": ((("time",), np.ones(1), one_off - 1, one_off),)},
        {"events": np.zeros((1, 2))},
        {"events": np.zeros((0, 0))},
    ],
)
def test_a_scorer_checks_its_arguments(wrong):
    scorer_of()
    with pytest.raises(ValueError, match="do not fit"):
        scorer_of(**wrong)


def test_a_scorer_refuses_a_term_without_a_formula():
    with pytest.raises(ValueError, match="no reward term 'tme'"):
        scorer_of(rewards=((("tme",), np.ones(1), FIRST, FIRST),))


def test_a_scorer_refuses_snapshots_of_another_race():
    snapshots = [
        Snapshot.of(np.zeros((), HEADER_DTYPE), np.zeros(n, KART_DTYPE), np.zeros(0, ITEM_DTYPE))
        for n in (0, 1)
    ]
    none, one = (snapshot.data for snapshot in snapshots)
    assert scorer_of().score(one, one, False)[1] == {"kart_0": False}
    with pytest.raises(ValueError, match="another race"):
        scorer_of().score(one, none, False)
    with pytest.raises(ValueError, match="not a snapshot"):
        scorer_of().infos(b"", 1)


def test_a_scorer_checks_arrays():
    scorer, rewards = scorer_of(), np.ones(3)
    ended, cut, table = np.ones(3, np.bool_), np.ones(3, np.bool_), np.ones((8, 3))
    scorer.score_into(KARTS, KARTS, True, FIRST + 1, rewards, ended, cut)
    assert (rewards.tolist(), ended.tolist()) == ([1, 0, 1], [True, False, True])
    scorer.infos_into(KARTS, 5, FIRST + 1, table)
    assert table.T.tolist() == [[1.0] * 8, [0.0] * 7 + [5.0], [1.0] * 8]
    with pytest.raises(ValueError, match="differ in length"):
        scorer.score_into(KARTS, KARTS, True, FIRST, rewards, ended[1:].copy(), cut)
    with pytest.raises(ValueError, match="2 slots for 1 agents"):
        scorer.score_into(KARTS, KARTS, True, TWO, rewards, ended, cut)
    with pytest.raises(ValueError, match="2 slots for 1 agents"):
        scorer.infos_into(KARTS, 5, TWO, table)
    with pytest.raises(ValueError, match="8 rows"):
        scorer.infos_into(KARTS, 5, FIRST, table[1:].copy())
    for slots in (FIRST + 3, FIRST - 1):
        with pytest.raises(IndexError, match="a slot index"):
            scorer.score_into(KARTS, KARTS, True, slots, rewards, ended, cut)
        with pytest.raises(IndexError, match="a slot index"):
            scorer.infos_into(KARTS, 5, slots, table)
    with pytest.raises(TypeError):
        scorer.score_into(KARTS, KARTS, True, FIRST, rewards, ended.astype(np.int8), cut)


def twin_of(track):
    """Returns the reference implementation of the same graph."""
    begins = np.cumsum([0, *map(len, track.successors)]).astype(np.intp)
    ends = np.array([node for nodes in track.successors for node in nodes], np.intp)
    arrays = track.path_nodes, track.path_width, track.path_distance, begins, ends
    return oracle.TrackGraph(*arrays, track.length)


@pytest.mark.slow
def test_the_order_ahead_is_the_same_on_every_track_and_segment():
    for name in SPLITS["all"]:
        with race_v0.parallel_env(num_kart=1, track=name) as env:
            env.reset(seed=0)
            track = env.track_map
        for node in range(0, track.num_nodes, 1 + track.num_nodes // 40):
            assert track.graph.ahead(node).tolist() == twin_of(track).ahead(node).tolist()


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
def test_joined_rows_match_the_reference_implementation(parts):
    assert join_rows(parts) == oracle.join_rows(parts)


def test_both_implementations_refuse_invalid_arguments():
    for make in (KartObserver, oracle.KartObserver):
        with pytest.raises(ValueError, match="no entry named"):
            make(("color",))
        with pytest.raises(ValueError, match="a fixed size"):
            make(("energy",), flat=True)
