"""Measures the limits of karts, and how well ``stkzoo.wrappers.control`` follows requests.

    python -m benchmarks.step_responses          # writes results/control.json and the plot

The first part measures the kart: throttle, drag, brake and steering range over speed, the steering
lag, and the wheel base and steering range of each kart model. It is the source of the constants of
``stkzoo.wrappers.control``. The second part records the kart's response to a step of each kind of
action.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import AgentSpec, Start, race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.agents.pursuit import PursuitDriver, PursuitState
from stkzoo.wrappers.control import CarParameters, ControlView
from stkzoo.wrappers.control.kart import KARTS

HERE = Path(__file__).parent
RESULTS = HERE / "results" / "control.json"
PLOT = HERE.parent / "docs" / "images" / "step_responses.png"

TICK = 1 / 120
_STEP = 0.1
#: A flat straight of 220 m, and a place where the road is 18 m wide.
STRAIGHT, STRAIGHT_NODE = "candela_city", 40
WIDE, WIDE_NODE = "scotland", 139

_BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")


def main() -> None:
    parser = CommandParser(prog="python -m benchmarks.step_responses", description=__doc__)
    parser.add_argument("--output", type=Path, default=RESULTS)
    parser.add_argument("--plot", type=Path, default=PLOT)
    arguments = parser.parse_args()
    kart = {"kart": kart_facts(), "karts": kart_models()}
    responses = {
        "speed": [speed_step(target) for target in (5.0, 10.0, 15.0)],
        "speed_down": [speed_step(target, 20.0) for target in (5.0, 0.0)],
        "accl": [accl_step(target, speed) for target, speed in ((4.0, 3.0), (-3.0, 18.0))],
        "steering_angle": [circle(radius) for radius in (4.0, 5.0, 6.5)],
        "steering_speed": [wheel_turn(0.1), wheel_turn(-0.05)],
        "laps": [lap(kinds) for kinds in KINDS],
    }
    results = kart | {"responses": responses}
    write_text(arguments.output, json.dumps(results, indent=1) + "\n")
    show(results)
    draw(responses, arguments.plot)


KINDS = [
    (longitudinal, steering)
    for longitudinal in ("speed", "accl")
    for steering in ("steering_angle", "steering_speed")
]


def game_action(throttle: float = 0.0, steer: float = 0.0, brake: int = 0) -> dict[str, Any]:
    numbers = {"acceleration": [throttle], "steer": [steer]}
    return {
        **{key: np.array(value, np.float32) for key, value in numbers.items()},
        **dict.fromkeys(_BUTTONS, 0),
        "brake": brake,
    }


def open_race(track: str, node: int, *, speed: float = 0.0, offset: float = 0.0, **options: Any):
    """Returns an environment in which one kart starts at a node of a track."""
    env = race_v0.parallel_env(num_kart=1, track=track, **options)
    env.reset(seed=1)
    distance = float(env.track_map.path_distance[node, 0]) + 2.0
    env.reset(seed=1, options={"start": Start(distance=distance, speed=speed, offset=offset)})
    return env


def forward(env: Any) -> float:
    return float(env.snapshot.karts[0]["velocity_lc"][2])


def kart_facts() -> dict[str, Any]:
    """Measures the speed over time at full throttle, coasting and braking, and the steering lag."""
    facts: dict[str, Any] = {}
    with open_race(STRAIGHT, STRAIGHT_NODE, step_size=TICK) as env:
        for name, action, seconds in (
            ("throttle", game_action(1.0), 4.5),
            ("brake", game_action(brake=1), 1.1),
        ):
            facts[name] = _recorded(env, action, seconds)
        throttle = facts["throttle"]
        angles = zip(throttle["speed"], throttle["max_steer_angle"], strict=True)
        facts["max_steer_angle"] = [list(pair) for pair in sorted(angles)[::10]]
        facts["top_speed"] = max(facts["throttle"]["speed"])
    with open_race(STRAIGHT, STRAIGHT_NODE, step_size=TICK, speed=20.0) as env:
        facts["coast"] = _recorded(env, game_action(), 4.0)
    with open_race(WIDE, WIDE_NODE, step_size=TICK, speed=8.0, offset=-4.0) as env:
        facts["turn"] = _recorded(env, game_action(0.4, 1.0), 0.4)
    rates = np.array(facts["turn"]["yaw_rate"])
    facts["turn_lag"] = float(np.argmax(np.abs(rates) > 0.63 * np.abs(rates).max()) * TICK)
    return facts


def _recorded(env: Any, action: dict[str, Any], seconds: float) -> dict[str, list[float]]:
    rows = []
    for _ in range(round(seconds / TICK)):
        env.step({"kart_0": action})
        kart = env.snapshot.karts[0]
        rows.append([kart["velocity_lc"][2], kart["angular_velocity"][1], kart["max_steer_angle"]])
    columns = np.round(np.array(rows, float), 4).T.tolist()
    return dict(zip(("speed", "yaw_rate", "max_steer_angle"), columns, strict=True))


def kart_models() -> dict[str, dict[str, float]]:
    """Returns the wheel base and the steering range at rest of each kart model."""
    models = {}
    for name in KARTS:
        with race_v0.parallel_env(
            agents=[AgentSpec(kart=name)], num_kart=1, track="lighthouse"
        ) as env:
            env.reset(seed=1)
            kart = env.snapshot.karts[0]
            models[name] = {
                "wheel_base": round(float(kart["wheel_base"]), 3),
                "max_steer_angle": round(float(kart["max_steer_angle"]), 3),
            }
    return models


def _driven(env: Any, controls: Any, steps: int) -> dict[str, list[float]]:
    """Drives with controls that are a function of the step number; returns the recording."""
    rows = []
    for step in range(steps):
        env.step({"kart_0": {"control": np.array(controls(step), np.float32)}})
        kart = env.snapshot.karts[0]
        x, _, z = kart["location"]
        rows.append([kart["velocity_lc"][2], kart["angular_velocity"][1], x, z])
    columns = np.round(np.array(rows, float), 4).T.tolist()
    return dict(zip(("speed", "yaw_rate", "x", "z"), columns, strict=True))


def speed_step(target: float, start: float = 0.0) -> dict[str, Any]:
    """Records the response to a target speed; the error is the largest one of the last second."""
    view = ControlView(observe="full", control_input=("speed", "steering_angle"))
    with open_race(STRAIGHT, STRAIGHT_NODE, speed=start, view=view) as env:
        record = _driven(env, lambda _: (0.0, target), 50)
    error = float(np.abs(np.array(record["speed"][-10:]) - target).max())
    return {"target": target, "start": start, "error": round(error, 3), **record}


def accl_step(target: float, start: float) -> dict[str, Any]:
    """Records the response to an acceleration; the error is that of the mean over 1.5 s."""
    view = ControlView(observe="full", control_input=("accl", "steering_angle"))
    with open_race(STRAIGHT, STRAIGHT_NODE, speed=start, view=view) as env:
        first = forward(env)
        record = _driven(env, lambda _: (0.0, target), 15)
    mean = (record["speed"][-1] - first) / 1.5
    return {"target": target, "start": start, "error": round(abs(mean - target), 3), **record}


def circle(radius: float) -> dict[str, Any]:
    """Drives a circle with a constant steering angle; the error is a fraction of the radius."""
    angle = CarParameters().steering_angle(radius)
    view = ControlView(observe="full", control_input=("speed", "steering_angle"))
    with open_race(WIDE, WIDE_NODE, speed=5.0, offset=-radius, view=view) as env:
        record = _driven(env, lambda _: (angle, 5.0), round(20.0 * np.pi * radius / 5.0))
    driven = fitted_radius(record["x"][8:], record["z"][8:])
    return {"target": radius, "driven": driven, "error": abs(driven / radius - 1.0), **record}


def fitted_radius(x: list[float], z: list[float]) -> float:
    """Returns the radius of the circle fitted to some points by least squares."""
    points = np.array([x, z])
    left = np.stack([*points, np.ones(len(x))], axis=1)
    solution, *_ = np.linalg.lstsq(left, (points * points).sum(axis=0), rcond=None)
    middle = solution[:2] / 2
    return float(np.sqrt(solution[2] + middle @ middle))


def wheel_turn(rate: float) -> dict[str, Any]:
    """Turns the wheels at a constant rate at 8 m/s; computes their angle from the yaw rate."""
    view = ControlView(observe="full", control_input=("speed", "steering_speed"))
    with open_race(WIDE, WIDE_NODE, speed=8.0, offset=-4.0 if rate > 0 else 4.0, view=view) as env:
        record = _driven(env, lambda _: (rate, 8.0), 12)
    speed = np.array(record["speed"])
    angle = np.arctan(CarParameters().wheel_base * np.abs(record["yaw_rate"]) / speed)
    driven = float(np.polyfit(np.arange(2, 12) * 0.1, angle[2:], 1)[0])
    record["angle"] = np.round(angle * np.sign(rate), 4).tolist()
    return {"target": rate, "driven": driven, "error": abs(driven / abs(rate) - 1.0), **record}


def lap(kinds: tuple[str, str], track: str = "lighthouse") -> dict[str, Any]:
    """Drives a lap with the pursuit driver and a pair of action kinds."""
    view = ControlView(observe="full", control_input=kinds, buttons=("rescue",))
    driver, state, angle = PursuitDriver(), PursuitState(), 0.0
    with race_v0.parallel_env(num_kart=1, track=track, view=view) as env:
        observations, infos = env.reset(seed=1)
        space = env.action_space("kart_0")["control"]
        while env.agents:
            seen = observations["kart_0"]
            control = control_of(kinds, driver.aim(seen), angle, float(seen["velocity"][2]))
            control = np.clip(control, space.low, space.high)
            angle = _wheels(kinds[1], angle, control, float(seen["max_steer_angle"][0]))
            rescue = driver(state, seen)["rescue"]
            action = {"control": control, "rescue": rescue}
            observations, _, ended, _, infos = env.step({"kart_0": action})
    finish = round(float(infos["kart_0"]["finish_time"]), 2)
    return {"control_input": kinds, "finished": bool(ended["kart_0"]), "finish_time": finish}


def control_of(
    kinds: tuple[str, str],
    aim: tuple[float, float],
    angle: float,
    speed: float,
) -> npt.NDArray[np.float32]:
    """Converts the driver's aim to a pair of action kinds, as an outer control loop would.

    Args:
        kinds: ``("speed" or "accl", "steering_angle" or "steering_speed")``.
        aim: steering angle [rad] and speed [m/s], from :meth:`PursuitDriver.aim`.
        angle: current angle of the wheels [rad].
        speed: current speed [m/s].

    Returns:
        ``(2,)`` float32, steering first.
    """
    longitudinal, steering = kinds
    first = aim[0] if steering == "steering_angle" else (aim[0] - angle) / _STEP
    second = aim[1] if longitudinal == "speed" else 3.0 * (aim[1] - speed)
    return np.array([first, second], np.float32)


def _wheels(kind: str, angle: float, control: Any, most: float) -> float:
    """Returns the estimated angle of the wheels after an action [rad]."""
    wanted = angle + float(control[0]) * _STEP if kind == "steering_speed" else float(control[0])
    return float(np.clip(wanted, -most, most))


def show(results: dict[str, Any]) -> None:
    facts, responses = results["kart"], results["responses"]
    print(f"top speed {facts['top_speed']:.2f} m/s, turning lags {facts['turn_lag']:.3f} s")
    for name, rows in responses.items():
        for row in rows:
            series = ("speed", "yaw_rate", "x", "z", "angle")
            print(name, {key: value for key, value in row.items() if key not in series})


def draw(responses: dict[str, Any], path: Path) -> None:
    """Plots the step responses."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    grid = figure.subplots(2, 2)
    (speeds, accls), (circles, wheels) = grid
    for row in [*responses["speed"], *responses["speed_down"]]:
        times = 0.1 * (1 + np.arange(len(row["speed"])))
        (line,) = speeds.plot(
            [0, *times], [row["start"], *row["speed"]], label=f"{row['target']:g}"
        )
        speeds.axhline(row["target"], color=line.get_color(), ls=":", lw=1)
    for row in responses["accl"]:
        times = 0.1 * (1 + np.arange(len(row["speed"])))
        (line,) = accls.plot(times, row["speed"], "o-", ms=3, label=f"{row['target']:g}")
        first = row["speed"][0]
        accls.plot(times, first + row["target"] * (times - 0.1), color=line.get_color(), ls=":")
    for row in responses["steering_angle"]:
        x, z = np.array(row["x"]), np.array(row["z"])
        circles.plot(
            x - x.mean(), z - z.mean(), label=f"{row['target']:g} m: {row['driven']:.2f} m"
        )
    for row in responses["steering_speed"]:
        times = 0.1 * (1 + np.arange(len(row["angle"])))
        (line,) = wheels.plot(times, row["angle"], "o-", ms=3, label=f"{row['target']:g}")
        wheels.plot(times, row["target"] * times, color=line.get_color(), ls=":")
    titles = (
        (speeds, "speed [m/s], dotted: requested", "time [s]", "m/s"),
        (accls, "accl [m/s²]: speed, dotted: requested", "time [s]", "m/s"),
        (circles, "steering_angle: requested and driven circles", "m", "m"),
        (wheels, "steering_speed [rad/s]: angle of the wheels", "time [s]", "rad"),
    )
    for axes, title, across, up in titles:
        axes.set(title=title, xlabel=across, ylabel=up)
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    circles.set_aspect("equal")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
