"""The game itself, driven in this process by ``pystk2``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.engine.starting import put_karts
from stkzoo.engine.track import encode_track
from stkzoo.errors import EngineError
from stkzoo.kernel import GameStepper
from stkzoo.kernel.reference import game_stepper
from stkzoo.names import AttachmentType, CameraMode, ItemType, Phase, PowerupType

#: More steps than any race needs before the engine shows READY (31 at 0.1 s).
_MAX_WARMUP_STEPS = 100_000

#: More letters of a kart's name would cover the picture.
_LONGEST_NAME = 20
_is_initialised = False


@dataclass(frozen=True, slots=True)
class RaceStart:
    """What is known of a race once its karts stand on the grid.

    Attributes:
        kart_types: model name of each kart, in grid order.
        track: the track as a block for :func:`stkzoo.engine.track.decode_track`.
        snapshot: the first moment, in phase READY.
    """

    kart_types: tuple[str, ...]
    track: bytes
    snapshot: Snapshot

    def to_frames(self) -> tuple[bytes, bytes, bytes]:
        """The start as three blocks of bytes."""
        return json.dumps(self.kart_types).encode(), self.track, self.snapshot.data

    @classmethod
    def from_frames(cls, kart_types: bytes, track: bytes, snapshot: bytes) -> RaceStart:
        """Reads what :meth:`to_frames` wrote."""
        return cls(tuple(json.loads(kart_types)), track, Snapshot(snapshot))


def init_engine(graphics: str = '{"preset": "none"}') -> None:
    """Starts the engine in this process, once; later calls do nothing.

    Args:
        graphics: fields of ``pystk2.GraphicsConfig`` as a JSON object, in which ``preset``
            names the preset for those left out; ``"none"`` is no graphics.
    """
    global _is_initialised
    if _is_initialised:
        return
    import pystk2

    _check_numbers(pystk2)
    pystk2.init(_graphics_config(pystk2, graphics))
    _is_initialised = True


def _graphics_config(pystk2: Any, graphics: str) -> Any:
    values = json.loads(graphics)
    preset = values.pop("preset", None)
    config = getattr(pystk2.GraphicsConfig, preset)() if preset else pystk2.GraphicsConfig()
    for name, value in values.items():
        setattr(config, name, value)
    return config


def _check_numbers(pystk2: Any) -> None:
    for ours, theirs in (
        (PowerupType, pystk2.Powerup.Type),
        (AttachmentType, pystk2.Attachment.Type),
        (ItemType, pystk2.Item.Type),
    ):
        expected = {kind.name: kind.value for kind in ours}
        found = {name: kind.value for name, kind in theirs.__members__.items()}
        if found != expected:
            raise EngineError(
                f"this PySuperTuxKart2 numbers its {ours.__name__} as {found}, stkzoo knows "
                f"{expected}; install PySuperTuxKart2==0.7.4 or a newer stkzoo"
            )


class GameRace:
    """One race of the engine in this process. At most one may live at a time."""

    def __init__(self, setup: RaceSetup) -> None:
        import pystk2

        self._setup = setup
        self._make_action = pystk2.Action
        self._actions = [self._make_action() for kart in setup.karts if not kart.is_bot]
        phases = Phase.READY_PHASE, Phase.SET_PHASE, Phase.GO_PHASE
        self._phases = {getattr(pystk2.WorldState.Phase, ours.name): ours for ours in phases}
        self._reporting = tuple(i for i, kart in enumerate(setup.karts) if kart.reports_control)
        self._race = pystk2.Race(race_config(setup))
        self._race.start()
        self._world = pystk2.WorldState()
        self._stepper: Any = None  # a GameStepper of the kernel, once the race is ready
        self._track = pystk2.Track()

    def begin(self) -> RaceStart:
        """Advances to the first moment on the grid, from which karts may act."""
        for _ in range(_MAX_WARMUP_STEPS):
            self._race.step()
            self._world.update()
            if self._phases.get(self._world.phase) == Phase.READY_PHASE:
                break
        else:
            raise EngineError(f"the race on {self._setup.track!r} never became ready")
        self._track.update()
        track = self._track
        if self._setup.starts:
            put_karts(self._race, self._world, track, self._setup, self._make_action)
        self._stepper = self._new_stepper()
        return RaceStart(
            kart_types=tuple(kart.kart_type for kart in self._world.karts),
            track=encode_track(track),
            snapshot=Snapshot(self._stepper.read(True)),
        )

    def step(self, controls: bytes | npt.NDArray[np.float32]) -> Snapshot:
        """Advances the game by one step.

        Args:
            controls: ``(P, 7)`` float32, or its bytes: a row for each player kart in grid
                order, columns as in :data:`stkzoo.engine.snapshot.CONTROLS`.
        """
        return Snapshot(self._stepper.step(controls))

    @property
    def serve(self) -> Callable[[int], bytes] | None:
        """Takes the steps that are asked for, until something else is, which it returns.

        Its argument is the descriptor of one end of :func:`stkzoo.engine.wire.pair`, without a
        time-out. It raises EOFError when the other end is gone. ``None`` if it is not available.
        """
        return getattr(self._stepper, "serve", None)

    def stop(self) -> None:
        """Ends the race; nothing else may be called afterwards."""
        self._race.stop()

    def _new_stepper(self) -> Any:
        """What steps and reads the race: by the engine's block, or attribute by attribute."""
        what: tuple[Any, ...] = self._race, self._world, self._actions, CONTROLS
        what += self._phases, Phase.RACE_PHASE, self._reporting
        by_attribute = game_stepper.GameStepper(*what)
        try:
            by_block = GameStepper(*what)
            is_right = by_block.read(True) == by_attribute.read(True)
        except (AttributeError, TypeError, ValueError):
            is_right = False
        return by_block if is_right else by_attribute


def race_config(setup: RaceSetup, *, has_cameras: bool = False) -> Any:
    """The engine's ``pystk2.RaceConfig``.

    Args:
        setup: the race.
        has_cameras: follow the karts' ``camera_mode``; otherwise no kart has a camera.
    """
    import pystk2

    config = pystk2.RaceConfig(
        num_kart=len(setup.karts),
        seed=setup.seed,
        difficulty=setup.difficulty,
        track=setup.track,
        laps=setup.laps,
    )
    config.reverse = setup.reverse
    config.step_size = setup.step_size
    # Any other number is that of the first karts, whatever they ask for; a camera without
    # graphics is the end of the game.
    config.num_cameras = 0
    config.players.clear()
    kinds = pystk2.PlayerConfig
    for kart in setup.karts:
        player = kinds(
            kart=kart.kart,
            name=_shown_name(kart.name),
            controller=kinds.Controller.AI_CONTROL
            if kart.is_bot
            else kinds.Controller.PLAYER_CONTROL,
            camera_mode=kinds.CameraMode(kart.camera_mode if has_cameras else CameraMode.OFF),
            color=kart.color,
        )
        config.players.append(player)
    return config


def _shown_name(name: str) -> str:
    """What the game can write above a kart: one short line."""
    return "".join(letter for letter in name if letter.isprintable())[:_LONGEST_NAME]
