"""Actions in physical units: their parts, their wrapper, and the motion of the karts."""

import tracemalloc
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from stkzoo import AgentSpec, ConfigError, Start, race_v0
from stkzoo.agents.pursuit import PursuitDriver, PursuitState
from stkzoo.views import VIEWS, find_view
from stkzoo.wrappers import ConstantSizedObservations, FlattenerWrapper, PolarObservations
from stkzoo.wrappers.control import (
    AcclAction,
    CarAction,
    CarParameters,
    ControlWrapper,
    LongitudinalAction,
    LongitudinalActionEnum,
    SpeedAction,
    SteerAction,
    SteerActionEnum,
    SteeringAngleAction,
    SteeringSpeedAction,
    from_single_to_multi_action_space,
)
from stkzoo.wrappers.control.kart import acceleration_of
from tests.support.generic_env import kart_env, number_env

KINDS = [
    (along, across)
    for along in ("speed", "accl")
    for across in ("steering_angle", "steering_speed")
]
STRAIGHT = {"track": "candela_city", "start": 190.0}


# ------------------------------------------------------------------ names and spaces


@pytest.mark.parametrize("kinds", KINDS)
def test_the_order_of_the_names_does_not_matter(kinds):
    one, other = CarAction(kinds), CarAction(kinds[::-1])
    assert one.type == other.type == kinds[::-1]
    assert one.space == other.space
    for method, state in (("controls", (3.0, 0.3, one.memory())), ("act", ([0, 0, 0.2, 3.0],))):
        results = [getattr(each, method)([0.1, 4.0], *state) for each in (one, other)]
        assert all(map(np.array_equal, *results))


def test_the_first_number_steers_and_the_second_drives():
    action = CarAction(["speed", "steering_angle"])
    controls, _ = action.controls([0.1, 25.0], 5.0, 0.2, action.memory())
    assert controls.tolist() == [1.0, 0.5, 0.0]


def test_a_single_name_is_completed_with_the_default():
    assert CarAction("accl").type == ("steering_angle", "accl")
    assert CarAction(["steering_speed"]).type == ("steering_speed", "speed")


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["speed", "accl"], "two names of the same kind"),
        (["speed", "wheel"], "'wheel', expected one of accl, speed"),
        ([], "expected one of"),
        ([1, 2], "expected one of"),
    ],
)
def test_invalid_names_are_refused(names, message):
    with pytest.raises(ConfigError, match=message):
        CarAction(names)


def test_parts_are_found_by_name():
    assert LongitudinalActionEnum.from_string("speed") is SpeedAction
    assert SteerActionEnum.from_string("steering_speed") is SteeringSpeedAction
    assert LongitudinalActionEnum.is_valid("accl")
    assert not SteerActionEnum.is_valid("accl")
    with pytest.raises(ConfigError, match="Did you mean 'speed'"):
        LongitudinalActionEnum.from_string("sped")
    with pytest.raises(ConfigError, match="Known: steering_angle, steering_speed"):
        SteerActionEnum.from_string("speed")


def test_parameters_can_be_a_mapping():
    assert CarAction(params={"T_steer": 0.2}).params == CarParameters(T_steer=0.2)
    with pytest.raises(ConfigError, match="sv_maxx"):
        CarAction(params={"sv_maxx": 1.0})
    with pytest.raises(ConfigError, match="expected CarParameters or a mapping"):
        CarAction(params=[1.0])


def test_lagging_wheels_reach_63_percent_after_the_time_constant():
    action = CarAction(params={"T_steer": 0.4, "sv_max": 100.0})
    memory = action.memory()
    for _ in range(4):
        controls, memory = action.controls([0.2, 5.0], 5.0, 0.425, memory)
    assert memory[0] == pytest.approx(0.2 * (1 - np.exp(-1)), rel=1e-6)
    assert controls[1] == pytest.approx(memory[0] / 0.425)
    asked = action.read(controls, 5.0, 0.425, memory[0] / (1 - np.exp(-1)) * (1 - np.exp(-0.75)))
    assert asked[0] == pytest.approx(0.2, abs=1e-6)


def test_spaces_are_in_physical_units_or_normalized():
    space = CarAction(["accl", "steering_speed"]).space
    assert space.low.tolist() == pytest.approx([-1.9, -17.5])
    assert space.high.tolist() == pytest.approx([1.9, 17.5])
    normal = CarAction(["speed", "steering_angle"], normalize=True)
    assert normal.space == spaces.Box(-1.0, 1.0, (2,), np.float32)


def test_action_spaces_of_several_agents_can_be_joined():
    single = CarAction().space
    assert from_single_to_multi_action_space(single, 3).shape == (3, 2)
    both = spaces.Dict({"control": single, "drift": spaces.Discrete(2)})
    joined = from_single_to_multi_action_space(both, 3)
    assert joined["control"].shape == (3, 2)
    assert joined["drift"].shape == (3,)
    with pytest.raises(ConfigError, match="num_agents is 0"):
        from_single_to_multi_action_space(single, 0)


def test_each_kart_has_its_own_parameters():
    assert CarParameters.of(None) == CarParameters.of(None, "tux")
    assert CarParameters.of(None, "wilber").wheel_base == 1.204
    with pytest.raises(ConfigError, match="Did you mean 'wilber'"):
        CarParameters.of(None, "wilbur")
    with pytest.raises(ConfigError, match="a_max is -1"):
        CarParameters(a_max=-1)
    with pytest.raises(ConfigError, match="v_min is 30"):
        CarParameters(v_min=30.0)


def test_the_engine_agrees_with_the_measured_kart_parameters():
    for kart in ("wilber", "gnu", ""):
        with race_v0.parallel_env(
            agents=[AgentSpec(kart=kart)], num_kart=1, track="lighthouse"
        ) as env:
            env.reset(seed=1)
            row = env.snapshot.karts[0]
            parameters = CarParameters.of(None, kart)
            assert row["wheel_base"] == pytest.approx(parameters.wheel_base, abs=2e-3)
            assert row["max_steer_angle"] == pytest.approx(parameters.s_max, abs=2e-3)


# ------------------------------------------------------------------ F1TENTH gymkhana's names

#: Limits as gymkhana's programs give them.
LIMITS = {"a_max": 9.5, "v_min": -5.0, "v_max": 20.0, "s_min": -0.41, "s_max": 0.41} | {
    "sv_min": -3.2,
    "sv_max": 3.2,
}
#: x, y, wheel angle [rad], speed [m/s], and more.
STATE = np.array([0.0, 0.0, 0.1, 8.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("normalize", [False, True])
@pytest.mark.parametrize("mode", [[*kinds] for kinds in KINDS])
def test_the_action_has_the_signature_of_gymkhana(mode, normalize):
    action = CarAction(control_mode=mode, params=LIMITS, normalize=normalize, timestep=0.05)
    same = CarAction(mode, LIMITS, normalize, 0.05)
    assert action.type == same.type == (mode[1], mode[0])
    assert action.space == same.space
    assert (action.normalize, action.timestep) == (same.normalize, same.timestep)
    assert (action.normalize, action.timestep) == (normalize, 0.05)
    bounds = [action.steer_bounds, action.throttle_bounds]
    assert pytest.approx(np.stack([action.space.low, action.space.high])) == np.array(bounds).T
    steering, longitudinal = SteerActionEnum, LongitudinalActionEnum
    parts = [steering.from_string(mode[1]), longitudinal.from_string(mode[0])]
    parts = [part(LIMITS, normalize, 0.05) for part in parts]
    assert [(part.lower_limit, part.upper_limit) for part in parts] == bounds
    numbers = [0.5, -0.25]
    accl, turning = action.act(numbers, state=STATE, params=LIMITS)
    by_part = [part.act(x, STATE, LIMITS) for part, x in zip(parts, numbers, strict=True)]
    assert (turning, accl) == tuple(by_part)
    karts = np.tile(STATE, (4, 3, 1))
    accls, turnings = action.act(np.tile(numbers, (4, 3, 1)), karts)
    assert accls == pytest.approx(np.full((4, 3), accl))
    assert turnings == pytest.approx(np.full((4, 3), turning))


@pytest.mark.parametrize(
    ("kind", "base", "name", "factor", "expected"),
    [
        (AcclAction, LongitudinalAction, "accl", 9.5, [0.5, 0.5 * 9.5]),
        (SpeedAction, LongitudinalAction, "speed", 12.5, [-7.5 * 8, (13.75 - 8) * 8]),
        (SteeringAngleAction, SteerAction, "steering_angle", 0.41, [3.2, 1.05]),
        (SteeringSpeedAction, SteerAction, "steering_speed", 3.2, [0.5, 1.6]),
    ],
)
def test_each_number_has_the_names_of_gymkhana(kind, base, name, factor, expected):
    plain, normal = kind(LIMITS, False), kind(params=LIMITS, normalize=True)
    assert isinstance(plain, base)
    assert plain.type == normal.type == name
    assert (plain.normalize, normal.normalize) == (False, True)
    assert (plain.scale_factor, normal.scale_factor) == (1.0, pytest.approx(factor))
    assert (normal.lower_limit, normal.upper_limit) == (-1.0, 1.0)
    assert (normal.low, normal.high) == (plain.lower_limit, plain.upper_limit)
    assert plain.upper_limit - plain.lower_limit == pytest.approx(2 * factor)
    assert plain.space == spaces.Box(plain.low, plain.high, (), np.float32)
    assert normal.space.contains(normal.space.sample())
    asked = [each.act(0.5, state=STATE, params=LIMITS) for each in (plain, normal)]
    assert asked == pytest.approx(expected)
    with pytest.raises(ConfigError, match="normalize is 3"):
        kind(normalize=3)


def test_enumerations_have_the_members_of_gymkhana():
    assert LongitudinalActionEnum.Accl is LongitudinalActionEnum.ACCL
    assert LongitudinalActionEnum.Speed is LongitudinalActionEnum.SPEED
    assert SteerActionEnum.Steering_Angle is SteerActionEnum.STEERING_ANGLE
    assert SteerActionEnum.Steering_Speed is SteerActionEnum.STEERING_SPEED
    joined = from_single_to_multi_action_space(
        single_agent_action_space=CarAction().space, num_agents=2
    )
    assert joined.shape == (2, 2)


@pytest.mark.parametrize("limits", [{"s_min": -0.3}, {"sv_min": 1.9}, {"s_min": 0.4, "s_max": 0.4}])
def test_limits_of_steering_are_symmetric(limits):
    with pytest.raises(ConfigError, match=r"s\w?_min is .*, expected -s\w?_max"):
        CarAction(params=limits)


# ------------------------------------------------------------------ pure functions


def test_wheels_do_not_exceed_their_steering_speed():
    action = CarAction(["speed", "steering_angle"])
    controls, memory = action.controls([0.4, 0.0], 0.0, 0.4, action.memory(), 0.1)
    assert memory[0] == pytest.approx(0.19)
    assert controls[1] == pytest.approx(0.19 / 0.4)


def test_steering_speed_stops_at_the_limit_and_reverses_immediately():
    action = CarAction(["speed", "steering_speed"])
    memory = action.memory()
    for _ in range(20):
        controls, memory = action.controls([1.0, 0.0], 10.0, 0.12, memory)
    assert controls[1] == 1.0
    controls, memory = action.controls([-1.0, 0.0], 10.0, 0.12, memory)
    assert memory[0] == pytest.approx(0.02)


def test_braking_reaches_the_requested_mean_acceleration():
    action = CarAction(["accl", "steering_angle"])
    memory, speed = action.memory(), 20.0
    for _ in range(15):
        controls, memory = action.controls([0.0, -6.0], speed, 0.1, memory)
        speed += 0.1 * float(acceleration_of(controls[0], controls[2] > 0, np.float64(speed), 0.1))
    assert speed == pytest.approx(20.0 - 9.0, abs=1.0)


def test_actions_can_be_recovered_from_controls():
    rng = np.random.default_rng(2)
    for kinds in KINDS:
        action = CarAction(kinds)
        for _ in range(50):
            speed, most, angle = (
                rng.uniform(6, 20),
                rng.uniform(0.07, 0.2),
                rng.uniform(-0.05, 0.05),
            )
            done = np.array([rng.uniform(0.3, 0.7), rng.uniform(-0.5, 0.5), 0.0])
            read = action.read(done, speed, most, angle)
            memory = np.array([angle, 0.0])
            again, _ = action.controls(read, speed, most, memory)
            np.testing.assert_allclose(again, done, atol=1e-4)


# ------------------------------------------------------------------ the wrapper


def test_buttons_are_separate_parts_of_the_action():
    env = ControlWrapper(kart_env(), buttons=("nitro", "drift"))
    assert list(env.action_space) == ["control", "drift", "nitro"]
    base = env.action({"control": np.zeros(2, np.float32), "drift": 1, "nitro": 0})
    assert env.env.action_space.contains(base)
    assert (base["drift"], base["nitro"], base["fire"], base["rescue"]) == (1, 0, 0, 0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"buttons": ["brake"]}, "unknown button 'brake'"),
        ({"step_size": 0}, "step_size is 0"),
        ({"normalize_act": 2}, "normalize_act is 2"),
        ({"params": 3}, "params is 3"),
    ],
)
def test_invalid_arguments_of_the_wrapper_are_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        ControlWrapper(kart_env(), **arguments)


def test_in_the_wrong_place_the_error_says_where_it_belongs():
    flat = FlattenerWrapper(PolarObservations(ConstantSizedObservations(kart_env())))
    with pytest.raises(
        ConfigError, match=r"inside the wrappers that flatten|around full or simple"
    ):
        ControlWrapper(flat)
    with pytest.raises(ConfigError, match="Dict space"):
        ControlWrapper(number_env())


def test_a_flattened_view_has_a_plain_box():
    env = VIEWS["flattened_control"](kart_env())
    assert env.action_space == spaces.Box(-1.0, 1.0, (2,), np.float32)
    with_buttons = find_view(("flattened_control", {"buttons": ("fire",)}))(kart_env())
    assert set(with_buttons.action_space.spaces) == {"continuous", "discrete"}


# ------------------------------------------------------------------ on the real engine


def drive(env, control, steps):
    """Applies one control for some steps; returns the speeds and locations after each step."""
    speeds, places = [], []
    for _ in range(steps):
        env.step({"kart_0": {"control": np.array(control, np.float32)}})
        kart = env.snapshot.karts[0]
        speeds.append(float(kart["velocity_lc"][2]))
        places.append(np.array(kart["location"], float))
    return np.array(speeds), np.array(places)


@pytest.mark.parametrize("target", [5.0, 10.0, 15.0])
def test_a_speed_is_reached_and_held_on_a_straight(target):
    with race_v0.parallel_env(num_kart=1, view=ControlWrapper, **STRAIGHT) as env:
        env.reset(seed=1)
        speeds, _ = drive(env, [0.0, target], 40)
    assert np.abs(speeds[-10:] - target).max() < 0.5


def test_a_kart_can_stop_and_drive_backward():
    with race_v0.parallel_env(num_kart=1, view=ControlWrapper, **STRAIGHT) as env:
        env.reset(seed=1, options={"start": Start(distance=190.0, speed=12.0)})
        speeds, _ = drive(env, [0.0, 0.0], 25)
        assert abs(speeds[-1]) < 0.1
        speeds, _ = drive(env, [0.0, -4.0], 25)
        assert np.mean(speeds[-10:]) == pytest.approx(-4.0, abs=1.5)


@pytest.mark.parametrize("radius", [4.0, 6.5])
def test_a_steering_angle_holds_a_circle(radius):
    angle = CarParameters().steering_angle(radius)
    with race_v0.parallel_env(num_kart=1, track="scotland", view=ControlWrapper) as env:
        env.reset(seed=1)
        distance = float(env.track_map.path_distance[139, 0]) + 2.0
        start = Start(distance=distance, offset=-radius, speed=5.0)
        env.reset(seed=1, options={"start": start})
        _, places = drive(env, [angle, 5.0], round(10 * 2 * np.pi * radius / 5.0))
    points = places[8:, [0, 2]]
    left = np.column_stack([points, np.ones(len(points))])
    solution = np.linalg.lstsq(left, (points**2).sum(axis=1), rcond=None)[0]
    driven = np.sqrt(solution[2] + (solution[:2] ** 2).sum() / 4)
    assert driven == pytest.approx(radius, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("kinds", KINDS)
def test_every_combination_drives_a_lap(kinds):
    view = (ControlWrapper, {"control_input": kinds, "buttons": ("rescue",)})
    driver, state, angle = PursuitDriver(), PursuitState(), 0.0
    with race_v0.parallel_env(num_kart=1, track="lighthouse", view=view) as env:
        observations, infos = env.reset(seed=1)
        space = env.action_space("kart_0")["control"]
        while env.agents:
            seen = observations["kart_0"]
            control = np.clip(
                requested(kinds, driver.aim(seen), angle, seen), space.low, space.high
            )
            turn = angle + 0.1 * control[0] if kinds[1] == "steering_speed" else control[0]
            angle = np.clip(turn, -seen["max_steer_angle"][0], seen["max_steer_angle"][0])
            action = {"control": control, "rescue": driver(state, seen)["rescue"]}
            observations, _, ended, _, infos = env.step({"kart_0": action})
    assert ended["kart_0"]
    assert 30.0 < infos["kart_0"]["finish_time"] < 70.0


def requested(kinds, aim, angle, seen):
    """Converts a driver's steering angle and speed to a pair of action kinds, steering first."""
    along, across = kinds
    steering = aim[0] if across == "steering_angle" else (aim[0] - angle) / 0.1
    speed = aim[1] if along == "speed" else 3.0 * (aim[1] - seen["velocity"][2])
    return np.array([steering, speed], np.float32)


def test_observed_actions_have_the_same_units():
    view = ("control", {"buttons": ("nitro",)})
    with race_v0.parallel_env(
        agents=[AgentSpec(use_ai=True)], num_kart=1, track="lighthouse", view=view
    ) as env:
        observations, _ = env.reset(seed=1)
        controls = []
        for _ in range(60):
            observations, *_ = env.step({})
            assert env.observation_space("kart_0").contains(observations["kart_0"])
            assert env.action_space("kart_0").contains(observations["kart_0"]["action"])
            controls.append(observations["kart_0"]["action"]["control"])
    speed = float(observations["kart_0"]["velocity"][2])
    assert abs(controls[-1][1] - speed) < 3.0
    assert np.ptp([control[0] for control in controls]) > 0.01


def test_a_race_can_be_repeated_and_restored():
    view = ("control", {"control_input": ("accl", "steering_speed")})
    script = np.random.default_rng(5).uniform([-0.6, -5], [0.6, 15], (40, 2)).astype(np.float32)

    def play(env, rows):
        seen = []
        for row in rows:
            observations, *_ = env.step({"kart_0": {"control": row}})
            seen.append(np.concatenate([observations["kart_0"]["velocity"], env.state()]))
        return np.array(seen)

    with race_v0.parallel_env(num_kart=1, track="lighthouse", view=view) as env:
        env.reset(seed=2)
        play(env, script[:25])
        with env.save_state() as state:
            first = play(env, script[25:])
            env.restore_state(state)
            assert np.array_equal(play(env, script[25:]), first)
        env.reset(seed=2)
        assert np.array_equal(play(env, script)[25:], first)


class Inner(gym.ObservationWrapper):
    """Changes nothing, but keeps the wrappers around it in Python."""

    def observation(self, observation):
        return observation


@pytest.mark.parametrize("inner", [lambda env: env, Inner], ids=["kernel", "python"])
def test_a_view_uses_the_step_of_its_race(inner):
    view = partial(ControlWrapper, control_input=("speed", "steering_speed"))

    def turned(env):
        """Returns how far one step turns the wheels at 1 rad/s."""
        action = {"kart_0": {"control": np.array([1.0, 5.0], np.float32)}}
        controls = env.live_race.convert(env.live_race.check(action))
        return controls[0, 1] * env.snapshot.karts["max_steer_angle"][0]

    race = {"num_kart": 1, "track": "lighthouse", "view": lambda env: view(inner(env))}
    with race_v0.parallel_env(**race) as env, race_v0.parallel_env(**race, step_size=0.05) as short:
        short.reset(seed=1)
        angles = [turned(short)]
        short.reset(seed=1)
        with short.save_state() as state:
            for options in ({"state": state}, {"scenario": short.scenario()}, {"step_size": 0.05}):
                env.reset(seed=1, options=options)
                angles.append(turned(env))
    assert angles == pytest.approx([0.05] * 4)


@pytest.mark.parametrize("speed", [1e6, 3e38])
def test_the_pursuit_driver_needs_little_memory_for_an_impossible_speed(speed):
    """A client of a server can send any observation."""
    with race_v0.parallel_env(num_kart=1, track="lighthouse", view="full") as env:
        observations, _ = env.reset(seed=1)
    seen = observations["kart_0"]
    PursuitDriver()(PursuitState(), seen)
    fast = {**seen, "velocity": np.float32([0, 0, speed])}
    tracemalloc.start()
    try:
        action = PursuitDriver()(PursuitState(), fast)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    assert np.isfinite(action["control"]).all()
