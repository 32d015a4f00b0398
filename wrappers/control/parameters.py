"""What a kart can do, in numbers measured on the engine."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from stkzoo.errors import ConfigError, unknown_name

#: Wheel base [m] and steering angle at rest [rad] of each kart model
#: (``benchmarks/results/control.json``).
KARTS = {
    "adiumy": (0.662, 0.279),
    "amanda": (1.036, 0.389),
    "emule": (0.804, 0.339),
    "gavroche": (0.893, 0.376),
    "gnu": (0.944, 0.398),
    "kiki": (0.861, 0.413),
    "konqi": (1.114, 0.469),
    "nolok": (0.992, 0.418),
    "pidgin": (0.872, 0.327),
    "puffy": (1.104, 0.414),
    "sara_the_racer": (0.808, 0.388),
    "sara_the_wizard": (0.856, 0.361),
    "suzanne": (0.986, 0.415),
    "tux": (1.008, 0.425),
    "wilber": (1.204, 0.577),
    "xue": (1.015, 0.427),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CarParameters:
    """Limits of the actions, and the model that the controllers go by.

    The defaults are those of the game's default kart, tux, at difficulty 2. The observed
    ``max_steer_angle`` narrows the steering further as the kart gets faster.

    Attributes:
        v_min: lowest speed that can be asked for, backwards [m/s].
        v_max: highest speed that can be asked for [m/s]: 25 is the game's own limit at
            difficulty 3; at 2, 1 and 0 karts reach 23, 20 and 15.
        a_max: largest acceleration and deceleration that can be asked for [m/s^2]: what the
            brake does. The engine gives 14 at rest and 3 at 20 m/s.
        s_max: largest steering angle, at rest [rad].
        sv_max: fastest turn of the wheels [rad/s]: lock to lock as the game lets those who
            steer with keys.
        wheel_base: [m]; a steering angle ``s`` drives a circle of radius
            ``wheel_base / tan(s)``.
        speed_gain: acceleration for each m/s that lacks [1/s].
    """

    v_min: float = -5.0
    v_max: float = 25.0
    a_max: float = 17.5
    s_max: float = 0.425
    sv_max: float = 1.9
    wheel_base: float = 1.008
    speed_gain: float = 8.0

    def __post_init__(self) -> None:
        names = ("v_min", "v_max", "a_max", "s_max", "sv_max", "wheel_base", "speed_gain")
        for name in names:
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise ConfigError(f"{name} is {value!r}, expected a number")
            if not math.isfinite(value) or (name != "v_min" and value <= 0):
                raise ConfigError(f"{name} is {value!r}, expected a finite number above 0")
        if self.v_min >= self.v_max:
            raise ConfigError(f"v_min is {self.v_min!r}, expected less than v_max={self.v_max!r}")
        if self.s_max >= math.pi / 2:
            raise ConfigError(f"s_max is {self.s_max!r}, expected radians below pi / 2")

    @classmethod
    def of_kart(cls, kart: str) -> CarParameters:
        """The parameters of a kart model.

        Args:
            kart: its name, such as ``"gnu"``; empty for the game's default.

        Raises:
            ConfigError: nobody has measured a kart of that name.
        """
        kart = kart or "tux"
        if kart not in KARTS:
            raise unknown_name("kart", kart, KARTS)
        wheel_base, s_max = KARTS[kart]
        return replace(cls(), wheel_base=wheel_base, s_max=s_max)

    def steering_angle(self, radius: float) -> float:
        """The steering angle [rad] that drives a circle of a radius [m], positive to the right."""
        return math.atan(self.wheel_base / radius)
