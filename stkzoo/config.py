"""Options for one agent and for the start of a race."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from stkzoo._checks import check_arguments, check_name, check_number, check_type
from stkzoo.errors import ConfigError
from stkzoo.names import CameraMode

__all__ = [
    "NORMAL",
    "RACE_MODES",
    "TIME_TRIAL",
    "AgentSpec",
    "RandomStart",
    "Start",
    "check_mode",
    "start_of",
]

#: The modes of a race: the normal race, and the game's time trial, which has no item boxes.
RACE_MODES = NORMAL, TIME_TRIAL = "normal", "time_trial"

#: Bounds of a start. The speed's is the top speed of a kart without nitro or zippers [m/s].
_START_BOUNDS = {
    "distance": (-1e3, 1e5),
    "share": (0.0, 1.0),
    "offset": (-100.0, 100.0),
    "heading": (-math.pi, math.pi),
    "speed": (0.0, 25.0),
    "behind": (0.0, 2e3),
}


@check_arguments
@dataclass
class AgentSpec:
    """Options of one agent. You may change fields after construction; the next reset applies them.

    Attributes:
        rank_start: position on the starting grid, 0 is the front; ``None`` draws a free position
            at every reset.
        use_ai: let the game's AI drive this kart. The environment ignores the agent's actions and
            adds the AI's choice to its observation as ``action``.
        name: player name.
        camera_mode: whether the kart has a camera when the game renders the race. Also accepts a
            name, such as ``"ON"``.
        kart: kart model, such as ``"gnu"`` (``stkzoo karts`` lists them); an empty string selects
            the game's default.
        color: hue shift of the kart, in [0, 1]; 0 keeps the original color.
        team: number of the agent's team; ``None`` for none. Karts of a team are marked in the view
            ``contest``, and :class:`~stkzoo.wrappers.marl.Teams` shares their rewards.
    """

    rank_start: int | None = None
    use_ai: bool = False
    name: str = ""
    camera_mode: CameraMode = CameraMode.AUTO
    kart: str = ""
    color: float = 0.0
    team: int | None = None

    @classmethod
    def of(cls, value: AgentSpec | Mapping[str, object], name: str = "agent") -> AgentSpec:
        """Converts a mapping of fields, for example from JSON or YAML, to a spec.

        Args:
            value: a spec, which is returned unchanged, or a mapping of its fields. ``camera_mode``
                may also be a number.
            name: name of the value in error messages, such as ``"agent 0"``.

        Raises:
            ConfigError: the value is neither a spec nor a mapping, or a field is unknown.
        """
        if isinstance(value, AgentSpec):
            return value
        check_type(name, value, Mapping, "an AgentSpec or a mapping of its fields")
        _check_fields(cls, value, name)
        mode = value.get("camera_mode")
        if isinstance(mode, int) and mode in list(CameraMode):
            value = {**value, "camera_mode": CameraMode(mode)}
        return cls(**value)  # type: ignore[arg-type]


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """A start position on the track, with heading and speed.

    Attributes:
        distance: distance along the center line from the start line [m]; negative before the line.
        share: position along the lap as a fraction, 0 to 1. Give either ``distance`` or ``share``.
        offset: lateral offset from the center line [m], positive to the right.
        heading: angle from the direction of the road [rad], positive to the right.
        speed: forward speed [m/s].
        behind: distance to move the start back along the road [m].

    Raises:
        ConfigError: a number is out of range, or both or neither of ``distance`` and ``share`` are
            given.
    """

    distance: float | None = None
    share: float | None = None
    offset: float = 0.0
    heading: float = 0.0
    speed: float = 0.0
    behind: float = 0.0

    def __post_init__(self) -> None:
        if (self.distance is None) == (self.share is None):
            raise ConfigError(f"{self!r} needs either a distance [m] or a share of the lap")
        for name, bounds in _START_BOUNDS.items():
            if (value := getattr(self, name)) is not None:
                number = check_number(f"{name} of a start", value, *bounds)
                object.__setattr__(self, name, number)


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class RandomStart:
    """Start positions drawn at every reset, each value uniformly between two bounds.

    Attributes:
        share: bounds of the position along the lap as a fraction, 0 to 1.
        offset: bounds of the lateral offset from the center line [m], positive to the right.
        heading: bounds of the angle from the direction of the road [rad], positive to the right.
        speed: bounds of the forward speed [m/s].

    Raises:
        ConfigError: a bound is out of range, or the lower bound exceeds the upper one.
    """

    share: tuple[float, float] = (0.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    heading: tuple[float, float] = (0.0, 0.0)
    speed: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            bounds = getattr(self, field.name)
            if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
                raise ConfigError(f"{field.name} is {bounds!r}, expected (lowest, highest)")
            low, high = (Start(**{"share": 0.0, field.name: bound}) for bound in bounds)
            if getattr(low, field.name) > getattr(high, field.name):
                raise ConfigError(f"{field.name} is {bounds!r}, expected (lowest, highest)")


def start_of(values: Mapping[str, object]) -> Start | RandomStart:
    """Converts a mapping of fields, for example from JSON or YAML, to a start.

    Args:
        values: fields of a :class:`Start`. If any value is a pair of bounds, fields of a
            :class:`RandomStart`.

    Raises:
        ConfigError: a field is unknown or its value is invalid.
    """
    pairs = {name: tuple(pair) for name, pair in values.items() if isinstance(pair, (tuple, list))}
    start_type: Any = RandomStart if pairs else Start
    _check_fields(start_type, values, "a start")
    start: Start | RandomStart = start_type(**{**values, **pairs})
    return start


def _check_fields(options: Any, values: Mapping[str, object], noun: str) -> None:
    """Checks that all keys are fields of a dataclass.

    Raises:
        ConfigError: a key is none.
    """
    known = [field.name for field in fields(options)]
    for name in values:
        check_name("field", name, known, f" of {noun}")


def check_mode(mode: object) -> None:
    """Checks the mode of a race.

    Args:
        mode: the mode, one of :data:`RACE_MODES`.

    Raises:
        ConfigError: there is no such mode.
    """
    check_name("mode", mode, RACE_MODES)
