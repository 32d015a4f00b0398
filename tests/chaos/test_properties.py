"""Any input is accepted or refused with stkzoo's own error: no hangs, exits or other errors.

To try more examples, set the environment variable ``STKZOO_EXAMPLES=2000``.
"""

import contextlib
import math
import os

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stkzoo
from stkzoo import ActionError, AgentSpec, ConfigError, StkzooError, race_v0
from stkzoo.race import RaceSettings, run_race
from stkzoo.views import VIEWS
from tests.support.processes import fork_server_of_races

pytestmark = pytest.mark.slow

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


class Tally:
    """Counts accepted inputs, so that a test fails if all are refused.

    Args:
        refusal: error with which an input may be refused; any other error fails the test.
    """

    def __init__(self, refusal=StkzooError):
        self._refusal = refusal
        self.num_accepted = self.num_refused = 0

    def try_call(self, call):
        """Calls a function; returns whether it accepted the input."""
        try:
            call()
        except self._refusal:
            self.num_refused += 1
            return False
        self.num_accepted += 1
        return True

    def assert_share(self, least):
        """Asserts that at least this fraction was accepted, and that some inputs were refused."""
        total = self.num_accepted + self.num_refused
        assert self.num_accepted >= least * total, (self.num_accepted, total)
        assert self.num_refused > 0, total


def or_odd(good):
    """Returns a strategy for valid values in nine of ten cases, and for odd values otherwise."""
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
    },
)


@pytest.fixture(scope="module", autouse=True)
def one_fork_server():
    """Checks that the same fork server survives all tests of this module."""
    with race_v0.parallel_env(num_kart=1, track=TRACKS[0]) as env:
        env.reset(seed=1)
        fork_server = fork_server_of_races()
        yield
        assert fork_server_of_races() is fork_server
        assert fork_server._process.poll() is None
        env.step({"kart_0": env.action_space("kart_0").sample()})


def test_any_options_are_accepted_or_refused():
    made, seeded = Tally(ConfigError), Tally(ConfigError)

    @QUICK
    @given(options=options, seed=or_odd(st.one_of(st.none(), st.integers(0, 2**31))))
    def try_options(options, seed):
        envs = []
        if made.try_call(lambda: envs.append(race_v0.parallel_env(**options))):
            with envs[0] as env:
                seeded.try_call(lambda: env.reset(seed=seed))
                env.reset(seed=1)
                for _ in range(2):
                    if env.agents:
                        _check(env, env.step({a: env.action_space(a).sample() for a in env.agents}))

    try_options()
    made.assert_share(0.2)
    assert seeded.num_accepted > 0


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


def test_any_episode_options_are_accepted_or_leave_the_race_unchanged(race):
    started = Tally(ConfigError)

    @QUICK
    @given(changes=or_odd(changes))
    def try_changes(changes):
        started.try_call(lambda: race.reset(options=changes))
        if not race.agents:
            race.reset(seed=1)
        _check(race, race.step({a: race.action_space(a).sample() for a in race.agents}))

    try_changes()
    started.assert_share(0.1)


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
changed_fields = st.one_of(
    st.just({}),
    st.dictionaries(st.sampled_from(NAMES), values, max_size=2),
    st.dictionaries(st.sampled_from([*NAMES, "jump", 3]), values, max_size=2),
)


def actions_of(space):
    """Returns a strategy for actions of a space, some of them with changed fields or odd values."""
    valid = st.integers(0, 2**31).map(lambda seed: _sample(space, seed))
    if isinstance(space, spaces.Dict):
        valid = st.builds(lambda action, changes: {**action, **changes}, valid, changed_fields)
    return or_odd(valid | st.lists(st.integers(-2, 2000), max_size=8))


def _sample(space, seed):
    space.seed(seed)
    return space.sample()


def test_any_actions_are_accepted_or_leave_the_race_unchanged(race):
    steps = Tally(ActionError)
    action = actions_of(race.action_space("kart_0"))

    @settings(QUICK, max_examples=4 * EXAMPLES)
    @given(actions=or_odd(st.fixed_dictionaries({"kart_0": action, "kart_1": action})))
    def try_actions(actions):
        if not race.agents:
            race.reset(seed=1)
        before = race.snapshot.karts.tobytes()
        if not steps.try_call(lambda: _check(race, race.step(actions))):
            assert race.snapshot.karts.tobytes() == before

    try_actions()
    steps.assert_share(0.1)


@pytest.mark.parametrize(
    "view",
    [
        *("box_discrete", "flattened", "racing"),
        *(
            pytest.param(view, marks=pytest.mark.matrix)
            for view in sorted({*VIEWS} - {"camera", "box_discrete", "flattened", "racing"})
        ),
    ],
)
def test_any_action_of_any_view_is_accepted_or_refused(view, views):
    env, steps = views(view), Tally(ActionError)
    env.reset(seed=1)

    @QUICK
    @given(action=actions_of(env.action_space("kart_0")))
    def try_action(action):
        if not env.agents:
            env.reset(seed=1)
        if not steps.try_call(lambda: _check(env, env.step({"kart_0": action}))):
            assert env.agents == ["kart_0"]

    try_action()
    steps.assert_share(0.2)


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


def test_any_batch_of_actions_is_accepted_or_refused():
    resets, steps = Tally(ConfigError), Tally(ActionError)
    with contextlib.closing(
        stkzoo.RaceVectorEnv(2, num_kart=2, track=TRACKS[0], prefetch=False)
    ) as envs:

        @QUICK
        @given(
            batch=odd | st.lists(st.integers(0, 1100), min_size=3, max_size=4),
            seed=odd | st.lists(st.integers(0, 5), min_size=1, max_size=2),
        )
        def try_batch(batch, seed):
            resets.try_call(lambda: envs.reset(seed=seed))
            envs.reset(seed=1)
            steps.try_call(lambda: envs.step(batch))
            assert envs.step(np.zeros(envs.num_envs, np.int64))[4]["active"].all()

        try_batch()
    resets.assert_share(0.1)
    steps.assert_share(0.03)


def test_any_race_settings_are_accepted_or_refused():
    races = Tally()

    @QUICK
    @given(
        chosen=st.dictionaries(
            st.sampled_from([*RaceSettings.__dataclass_fields__, "nonsense"]), odd, max_size=2
        ),
        drivers=or_odd(st.lists(st.sampled_from(["ai", "heuristic", "random"]), max_size=3)),
    )
    def try_settings(chosen, drivers):
        options = {"track": TRACKS[0], "inline": True, **chosen, "max_steps": 2}
        races.try_call(lambda: run_race(drivers, **options))

    try_settings()
    races.assert_share(0.1)
