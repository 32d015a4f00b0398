"""The observation and action spaces of the ``full`` view, on which all other views build."""

from __future__ import annotations

import string
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import CONTROLS
from stkzoo.names import AttachmentType, GroundKind, ItemType, Phase, PowerupType

#: Upper bound of observed powerup counts; the highest count seen in the game is 6.
POWERUP_COUNT_LIMIT = 9

#: Distances along the road at which the ground is observed, starting beside the kart [m].
GROUND_MARKS = np.arange(0.0, 108.0, 3.0, dtype=np.float32)
#: Lateral positions at which the ground is observed, relative to the driving line [m]; positive
#: is to the right.
GROUND_LANES = np.arange(-9.0, 9.1, 0.75, dtype=np.float32)
#: Distances along the racing line at which it is observed, starting beside the kart [m].
GROUND_LINE_MARKS = np.arange(0.0, 109.0, 3.0, dtype=np.float32)

_KART_NAME_CHARACTERS = string.ascii_letters + string.digits + "_-"


def kart_action_space() -> spaces.Dict:
    """Returns a new action space of one kart.

    ``acceleration`` (1,) in [0, 1] and ``steer`` (1,) in [-1, 1] are float32. ``steer`` is a
    fraction of the kart's ``max_steer_angle``; positive is right. The buttons ``brake``, ``drift``,
    ``fire``, ``nitro`` and ``rescue`` are 0 or 1.
    """
    return spaces.Dict(
        {
            "acceleration": spaces.Box(0, 1, shape=(1,)),
            "steer": spaces.Box(-1, 1, shape=(1,)),
            **{button: spaces.Discrete(2) for button in CONTROLS[2:]},
        }
    )


def as_actions(controls: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[Any]]:
    """Converts controls ``(..., 7)`` to actions: floats ``(..., 1)`` and buttons ``(...)``."""
    buttons = {
        name: controls[..., place].astype(np.int64)
        for place, name in enumerate(CONTROLS[2:], start=2)
    }
    return {"acceleration": controls[..., 0:1], "steer": controls[..., 1:2], **buttons}


def action_of(controls: npt.NDArray[np.float32]) -> dict[str, Any]:
    """Converts controls ``(7,)`` to an action: floats ``(1,)`` and buttons ``int``."""
    buttons = {name: int(controls[place]) for place, name in enumerate(CONTROLS[2:], start=2)}
    return {"acceleration": controls[:1], "steer": controls[1:2], **buttons}


def controls_of(action: Mapping[str, Any]) -> list[float]:
    """Converts an action to a row of controls."""
    return [float(np.asarray(action[name]).reshape(())) for name in CONTROLS]


#: The standing of a kart in the race: name, number of values, unit and meaning of each part. All
#: values are clipped to -5 and 5.
STANDING = (
    ("rank", 1, "", "rank: 0 is first, 1 is last"),
    ("progress", 1, "", "share of the race that the kart has driven"),
    ("last_controls", 2, "", "steering and drift of the latest step"),
    (
        "rivals",
        36,
        "20 m, 20 m/s",
        "4 x 9, the nearest karts: 1 if there is one, position and velocity relative to the kart "
        "(right, up, ahead), lead along the race, 1 for a teammate",
    ),
)
STANDING_SIZE = sum(size for _, size, *_ in STANDING)
#: Multiplying the standing by it mirrors the race left to right.
STANDING_MIRROR = np.array([1, 1, -1, 1, *4 * [1, -1, 1, 1, -1, 1, 1, 1, 1]], np.float32)

#: Optional parts of an observation, each with an entry that identifies it.
EXTRAS = {"ground": "ground_kind", "motion": "karts_velocity", "standing": "standing"}


def kart_observation_space(use_ai: bool = False, extras: Collection[str] = ()) -> spaces.Dict:
    """Returns a new observation space of one kart in the ``full`` view.

    Args:
        use_ai: whether to add ``action``, the choice of the game's AI, in the space of
            :func:`kart_action_space`.
        extras: names from :data:`EXTRAS`. ``"ground"`` adds ``ground_kind`` and ``ground_speed``,
            the ground ahead at :data:`GROUND_MARKS` and :data:`GROUND_LANES`, and ``ground_line``
            and ``ground_room``, the racing line at :data:`GROUND_LINE_MARKS`; ``"motion"`` adds
            ``karts_velocity`` and ``karts_heading``, the motion of the other karts; ``"standing"``
            adds ``standing``, :data:`STANDING`.
    """
    inf = float("inf")

    def box(size: int, low: float = -inf) -> spaces.Box:
        return spaces.Box(low, inf, shape=(size,), dtype=np.float32)

    space = spaces.Dict(
        {
            "kart_type": spaces.Text(32, min_length=1, charset=_KART_NAME_CHARACTERS),
            "aux_ticks": box(1, 0),
            "phase": spaces.Discrete(max(Phase) + 1),
            "powerup_type": spaces.Discrete(max(PowerupType) + 1),
            "powerup_count": spaces.Discrete(POWERUP_COUNT_LIMIT + 1),
            "attachment": spaces.Discrete(max(AttachmentType) + 1),
            "skeed_factor": box(1, 0),
            "energy": box(1, 0),
            "attachment_time_left": box(1, 0),
            "shield_time": box(1, 0),
            "velocity": box(3),
            "max_steer_angle": spaces.Box(-1, 1, shape=(1,), dtype=np.float32),
            "distance_down_track": box(1),
            "center_path_distance": box(1),
            "center_path": box(3),
            "front": box(3),
            "jumping": spaces.Discrete(2),
            "items_position": spaces.Sequence(box(3)),
            "items_type": spaces.Sequence(spaces.Discrete(max(ItemType) + 1)),
            "karts_position": spaces.Sequence(box(3)),
            "paths_distance": spaces.Sequence(box(2, 0)),
            "paths_width": spaces.Sequence(box(1, 0)),
            "paths_start": spaces.Sequence(box(3)),
            "paths_end": spaces.Sequence(box(3)),
        }
    )
    if "ground" in extras:
        cells = len(GROUND_MARKS), len(GROUND_LANES)
        space["ground_kind"] = spaces.Box(0, int(max(GroundKind)), cells, np.uint8)
        space["ground_speed"] = spaces.Box(0.0, 1.0, cells, np.float32)
        marks = len(GROUND_LINE_MARKS)
        space["ground_line"] = spaces.Box(-inf, inf, (marks, 3), np.float32)
        space["ground_room"] = spaces.Box(0.0, inf, (marks, 2), np.float32)
    if "motion" in extras:
        space["karts_velocity"] = spaces.Sequence(box(3))
        heading = spaces.Box(-np.pi, np.pi, shape=(1,), dtype=np.float32)
        space["karts_heading"] = spaces.Sequence(heading)
    if "standing" in extras:
        space["standing"] = spaces.Box(-5.0, 5.0, (STANDING_SIZE,), np.float32)
    if use_ai:
        space["action"] = kart_action_space()
    return space


def extras_of(space: spaces.Space[Any]) -> frozenset[str]:
    """Returns the :data:`EXTRAS` that observations of a space contain."""
    entries = space.spaces if isinstance(space, spaces.Dict) else {}
    return frozenset(extra for extra, entry in EXTRAS.items() if entry in entries)
