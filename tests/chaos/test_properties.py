"""Any input either works or is refused in our own words: never a hang, an exit, a bare error.

By hand, with other examples each time, ``STKZOO_EXAMPLES=2000`` in the environment.
"""

import contextlib
import inspect
import math
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stkzoo
from stkzoo import ActionError, AgentSpec, ConfigError, StkzooError, race_v0
from stkzoo.engine import process
from stkzoo.race import RaceSettings, run_race
from stkzoo.views import VIEWS

EXAMPLES = int(os.environ.get("STKZOO_EXAMPLES", "30"))
QUICK = settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    derandomize=EXAMPLES == 30,
    database=None,
)
TRACKS = ("olivermath", "lighthouse")
KARTS = ("gnu", "tux", "")

odd = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-3, 8),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.just([]),
    st.just({}),
    st.just(object()),
    st.sampled_from([np.int64(2), np.float32("nan"), np.zeros(2), np.array(1)]),
)


def or_odd(good):
    """What is right, mostly."""
    return st.integers(0, 9).flatmap(lambda chance: odd if chance == 0 else good)


specs = st.builds(
    AgentSpec,
    rank_start=or_odd(st.one_of(st.none(), st.integers(0, 3))),
    use_ai=or_odd(st.booleans()),
    name=or_odd(st.text(max_size=8)),
    kart=or_odd(st.sampled_from(KARTS)),
    color=or_odd(st.floats(0, 1)),
    camera_mode=or_odd(st.just(stkzoo.CameraMode.AUTO)),
)

options = st.fixed_dictionaries(
    {"num_kart": or_odd(st.integers(1, 4)), "track": or_odd(st.sampled_from(TRACKS))},
    optional={
        "agents": or_odd(st.one_of(st.integers(1, 4), st.lists(specs, min_size=1, max_size=4))),
        "laps": or_odd(st.integers(1, 3)),
        "difficulty": or_odd(st.integers(0, 3)),
        "max_paths": or_odd(st.one_of(st.none(), st.integers(1, 20))),
        "step_size": or_odd(st.floats(0.02, 0.5)),
        "view": or_odd(st.sampled_from([*VIEWS])),
        "reward": or_odd(st.sampled_from([None, "placement", {"time": 2.0}])),
        "reverse": or_odd(st.booleans()),
        "max_cycles": or_odd(st.one_of(st.none(), st.integers(1, 50))),
        "start": or_odd(st.sampled_from([None, 0.0, "random", stkzoo.Start(share=0.5)])),
        "num_cameras": or_odd(st.integers(0, 2)),
        "render_backend": or_odd(st.sampled_from(["auto", "map"])),
        "render_size": or_odd(st.just((64, 48))),
        "engine_timeout": or_odd(st.just(30.0)),
        "max_snapshots": or_odd(st.integers(1, 5)),
    },
)


@pytest.fixture(scope="module", autouse=True)
def one_fork_server():
    """The process that all races come from lives through all of it."""
    with race_v0.parallel_env(num_kart=1, track=TRACKS[0]) as env:
        env.reset(seed=1)
        (fork_server,) = process._fork_servers.values()
        yield
        assert list(process._fork_servers.values()) == [fork_server]
        assert fork_server._process.poll() is None
        env.step({"kart_0": env.action_space("kart_0").sample()})


@QUICK
@given(options=options, seed=or_odd(st.one_of(st.none(), st.integers(0, 2**31))))
def test_any_options_make_a_race_or_are_refused(options, seed):
    try:
        env = race_v0.parallel_env(**options)
    except ConfigError:
        return
    with env:
        with contextlib.suppress(ConfigError):
            env.reset(seed=seed)
        env.reset(seed=1)
        for _ in range(2):
            if env.agents:
                _check(env, env.step({a: env.action_space(a).sample() for a in env.agents}))


def _check(env, result):
    observations, rewards, *_ = result
    for agent, seen in observations.items():
        assert env.observation_space(agent).contains(seen)
    assert all(map(math.isfinite, rewards.values()))


changes = st.dictionaries(
    st.sampled_from(["track", "laps", "difficulty", "reverse", "max_cycles", "step_size", "start"])
    | st.sampled_from(["num_kart", "state", "scenario", "nonsense"]),
    odd | st.sampled_from([*TRACKS, 1, 2, 0.1, True]),
    max_size=3,
)


@QUICK
@given(changes=or_odd(changes))
def test_any_options_of_an_episode_start_it_or_are_refused_and_the_race_goes_on(race, changes):
    with contextlib.suppress(ConfigError):
        race.reset(options=changes)
    if not race.agents:
        race.reset(seed=1)
    _check(race, race.step({agent: race.action_space(agent).sample() for agent in race.agents}))


@pytest.fixture(scope="module")
def race():
    with race_v0.parallel_env(num_kart=2, track=TRACKS[0], view="simple") as env:
        env.reset(seed=1)
        yield env


values = st.one_of(
    odd,
    st.floats(-3, 3),
    st.lists(st.floats(), max_size=3),
    st.floats(width=32).map(lambda value: np.array([value], np.float32)),
    st.floats().map(lambda value: np.array([value], np.float64)),
    st.integers(0, 1),
)
NAMES = ("acceleration", "brake", "drift", "fire", "nitro", "rescue", "steer")
actions = st.one_of(
    odd,
    st.fixed_dictionaries(dict.fromkeys(NAMES, values)),
    st.dictionaries(st.sampled_from([*NAMES, "jump", 3]), values),
)


@settings(QUICK, max_examples=4 * EXAMPLES)
@given(
    first=actions, second=actions, names=st.sets(st.sampled_from(["kart_0", "kart_1", "kart_7"]))
)
def test_any_actions_move_the_race_or_are_refused_and_it_stands_still(race, first, second, names):
    given = dict(zip(sorted(names), (first, second, first), strict=False))
    if not race.agents:
        race.reset(seed=1)
    before = race.snapshot.karts.tobytes()
    try:
        result = race.step(given)
    except ActionError:
        assert race.snapshot.karts.tobytes() == before
    else:
        _check(race, result)


@pytest.mark.parametrize("view", sorted({*VIEWS} - {"camera"}))
@QUICK
@given(given=odd | st.lists(st.integers(-2, 2000), max_size=8) | actions)
def test_any_action_of_any_view_is_taken_or_refused(given, view, views):
    env = views(view)
    if not env.agents:
        env.reset(seed=1)
    try:
        result = env.step({"kart_0": given})
    except ActionError:
        assert env.agents == ["kart_0"]
    else:
        _check(env, result)


@pytest.fixture(scope="module")
def views():
    made = {}

    def of(view):
        if view not in made:
            made[view] = race_v0.parallel_env(num_kart=1, track=TRACKS[0], view=view)
            made[view].reset(seed=1)
        return made[view]

    yield of
    for env in made.values():
        env.close()


@QUICK
@given(
    num_races=or_odd(st.integers(1, 2)),
    batch=odd | st.lists(st.integers(-1, 1200), min_size=2, max_size=4),
    seed=odd | st.lists(st.integers(0, 5), min_size=1, max_size=2),
)
def test_any_batch_is_stepped_or_refused(num_races, batch, seed):
    try:
        envs = stkzoo.RaceVectorEnv(num_races, num_kart=2, track=TRACKS[0], prefetch=False)
    except ConfigError:
        return
    try:
        with contextlib.suppress(ConfigError):
            envs.reset(seed=seed)
        envs.reset(seed=1)
        with contextlib.suppress(ActionError):
            envs.step(batch)
        assert envs.step(np.zeros(envs.num_envs, np.int64))[4]["active"].all()
    finally:
        envs.close()


@QUICK
@given(
    chosen=st.dictionaries(
        st.sampled_from([*RaceSettings.__dataclass_fields__, "nonsense"]), odd, max_size=2
    ),
    drivers=or_odd(st.lists(st.sampled_from(["ai", "heuristic", "random"]), max_size=3)),
)
def test_any_settings_of_a_race_run_it_or_are_refused(chosen, drivers):
    with contextlib.suppress(StkzooError):
        run_race(drivers, **{"track": TRACKS[0], "inline": True, **chosen, "max_steps": 2})


# ---------------------------------------------------------------------- each argument, each oddity

ODD = (
    None, True, -1, 0, 10**30, 1.5, float("nan"), "", "x" * 5000, "\ud800", b"x", [], [None], {},
    {1: 2}, (1, 2), object(), np.float32("nan"), np.zeros(2), np.array(1), int, set(), range(3), 1j,
)  # fmt: skip
ARGUMENTS = [
    name
    for name in inspect.signature(stkzoo.RaceParallelEnv.__init__).parameters
    if name not in ("self", "render_mode", "track")  # a window, and any of all tracks
]


def in_our_words(call):
    """Calls; any error must be one of ours."""
    with contextlib.suppress(StkzooError):
        call()


@pytest.mark.parametrize("name", ARGUMENTS)
def test_each_argument_takes_or_refuses_each_oddity(name):
    for value in ODD:
        options = {"num_kart": 2, "track": TRACKS[0], name: value}
        in_our_words(lambda options=options: race_v0.parallel_env(**options).close())


def test_each_field_takes_or_refuses_each_oddity():
    for value in ODD:
        for name in AgentSpec.__dataclass_fields__:
            agents = [AgentSpec(**{name: value})]
            options = {"agents": agents, "num_kart": 2, "track": TRACKS[0]}
            in_our_words(lambda options=options: race_v0.parallel_env(**options).close())
        for kind in (RaceSettings, stkzoo.Start):
            for name in kind.__dataclass_fields__:
                in_our_words(lambda kind=kind, name=name, value=value: kind(**{name: value}))


def test_each_method_takes_or_refuses_each_oddity(race):
    race.reset(seed=1)
    for value in ODD:
        for name in ("observe_batch", "restore_state", "step"):
            in_our_words(lambda name=name, value=value: getattr(race, name)(value))
        in_our_words(lambda value=value: setattr(race, "max_cycles", value))
        race.max_cycles = None
    race.reset(seed=1)


def test_a_race_of_agents_takes_or_refuses_each_oddity():
    for name in ("drivers", "settings", "start_positions", "wait_for", "listeners"):
        for value in ODD:
            given = {"drivers": ["ai"], "track": TRACKS[0], "max_steps": 1, name: value}
            in_our_words(lambda given=given: run_race(**given))
