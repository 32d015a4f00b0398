"""The game in this process, run with ``pystk2``."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._schema import plain_name
from stkzoo.config import NORMAL, TIME_TRIAL
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.starting import put_karts
from stkzoo.engine.track import encode_track
from stkzoo.errors import EngineError
from stkzoo.kernel import GameStepper
from stkzoo.names import AttachmentType, CameraMode, ItemType, Phase, PowerupType

#: Maximum number of steps before the phase READY; a race needs 31 at a step size of 0.1 s.
_MAX_WARMUP_STEPS = 100_000

#: Maximum length of a kart's name. Longer names would cover the image.
_LONGEST_NAME = 20
#: The engine's names of the modes.
_GAME_MODES = {NORMAL: "NORMAL_RACE", TIME_TRIAL: "TIME_TRIAL"}
#: What to do if the engine differs from the one that stkzoo knows.
_REMEDY = "install PySuperTuxKart2==0.7.4 or a newer stkzoo"
#: The engine's names of record fields, where they differ from the field's name.
_ATTRIBUTES = {
    "attachment_time_left": "attachment.time_left",
    "attachment_type": "attachment.type.value",
    "powerup_num": "powerup.num",
    "powerup_type": "powerup.type.value",
    "type": "type.value",
}
#: Read all fields of a record in order, except for a kart's last field, its control.
_item_of, _kart_of = (
    attrgetter(*(_ATTRIBUTES.get(name, name) for name in names))
    for names in (ITEM_DTYPE.names or (), (KART_DTYPE.names or ())[:-1])
)


@dataclass(frozen=True, slots=True)
class RaceStart:
    """The data of a race when its karts are ready to start.

    Attributes:
        kart_types: model name of each kart, in grid order.
        track: the encoded track; :func:`stkzoo.engine.track.decode_track` decodes it.
        snapshot: the first snapshot, in phase READY unless the race has custom starts.
    """

    kart_types: tuple[str, ...]
    track: bytes
    snapshot: Snapshot

    def to_frames(self) -> tuple[bytes, bytes, bytes]:
        """Returns the start as three blocks of bytes: kart types, track and snapshot."""
        return json.dumps(self.kart_types).encode(), self.track, self.snapshot.data

    @classmethod
    def from_frames(cls, kart_types: bytes, track: bytes, snapshot: bytes) -> RaceStart:
        """Decodes the blocks of :meth:`to_frames`."""
        return cls(tuple(json.loads(kart_types)), track, Snapshot(snapshot))


def init_engine(graphics: str = '{"preset": "none"}') -> None:
    """Starts the engine in this process. A second call would crash it.

    Args:
        graphics: fields of ``pystk2.GraphicsConfig`` as a JSON object. Its key ``preset`` names
            the preset of the other fields; ``"none"`` disables graphics.

    Raises:
        EngineError: the installed ``pystk2`` numbers powerups, attachments or items differently.
    """
    import pystk2

    _check_numbers(pystk2)
    pystk2.init(_graphics_config(pystk2, graphics))


def _graphics_config(pystk2: Any, graphics: str) -> Any:
    values = json.loads(graphics)
    preset = values.pop("preset", None)
    config = getattr(pystk2.GraphicsConfig, preset)() if preset else pystk2.GraphicsConfig()
    for name, value in values.items():
        setattr(config, name, value)
    return config


def _check_numbers(pystk2: Any) -> None:
    for enumeration, engine_type in (
        (PowerupType, pystk2.Powerup.Type),
        (AttachmentType, pystk2.Attachment.Type),
        (ItemType, pystk2.Item.Type),
    ):
        expected = {member.name: member.value for member in enumeration}
        numbers = {name: member.value for name, member in engine_type.__members__.items()}
        if numbers != expected:
            raise EngineError(
                f"this PySuperTuxKart2 numbers its {enumeration.__name__} as {numbers}, stkzoo "
                f"knows {expected}; {_REMEDY}"
            )


class GameRace:
    """One race of the engine in this process. A process can have only one at a time.

    Args:
        setup: options of the race.
    """

    def __init__(self, setup: RaceSetup) -> None:
        import pystk2

        self._setup = setup
        self._make_action = pystk2.Action
        self._actions = [self._make_action() for kart in setup.karts if not kart.is_bot]
        phases = Phase.READY_PHASE, Phase.SET_PHASE, Phase.GO_PHASE
        self._phases: dict[Any, int] = {
            getattr(pystk2.WorldState.Phase, ours.name): ours for ours in phases
        }
        self._reporting = tuple(i for i, kart in enumerate(setup.karts) if kart.reports_control)
        self._race = pystk2.Race(race_config(setup))
        self._race.start()
        self._world = pystk2.WorldState()
        self._stepper: Any = None  # a GameStepper after begin()
        self._track = pystk2.Track()

    def begin(self) -> RaceStart:
        """Advances the race to its first snapshot, after which karts can act.

        Raises:
            EngineError: the race does not reach the phase READY.
            ConfigError: a kart cannot start where ``setup.starts`` places it.
        """
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
            snapshot=Snapshot(self._stepper.read()),
        )

    def step(self, controls: bytes | npt.NDArray[np.float32]) -> Snapshot:
        """Advances the game by one step and returns the snapshot after it.

        Args:
            controls: ``(P, 7)`` float32 or its bytes: one row per player kart in grid order,
                with the columns of :data:`stkzoo.engine.snapshot.CONTROLS`.
        """
        return Snapshot(self._stepper.step(controls))

    @property
    def serve(self) -> Callable[[int], bytes] | None:
        """Function that serves step requests until another request arrives, which it returns.

        Its argument is the descriptor of one end of :func:`stkzoo.engine.wire.pair`, without a
        timeout. It raises EOFError when the other end is closed. ``None`` on Windows, whose sockets
        are no descriptors.
        """
        return getattr(self._stepper, "serve", None)

    def stop(self) -> None:
        """Ends the race. Do not call any other method afterwards."""
        self._race.stop()

    def _new_stepper(self) -> GameStepper:
        """Returns the object that steps and reads the race.

        Raises:
            EngineError: the engine's block of memory, which it reads, differs from the attributes.
        """
        race, world = self._race, self._world
        try:
            functions = race.step, race.get_kart_action, world.update, world.__getstate__
            stepper = GameStepper(
                functions,
                world,
                self._actions,
                CONTROLS,
                self._phases,
                Phase.RACE_PHASE,
                self._reporting,
                np.flatnonzero([not kart.is_bot for kart in self._setup.karts]),
            )
            is_right = stepper.read() == self.read_attributes().data
        except (AttributeError, TypeError, ValueError):
            is_right = False
        if not is_right:
            raise EngineError(f"this PySuperTuxKart2 lays out its state differently; {_REMEDY}")
        return stepper

    def read_attributes(self) -> Snapshot:
        """Reads the snapshot of a race that is running from the engine's attributes, one by one.

        A step reads the engine's block of memory, which is much faster, but whose layout the engine
        does not guarantee.
        """
        world = self._world
        karts = np.array([(*_kart_of(kart), (0.0,) * 7) for kart in world.karts], KART_DTYPE)
        items = np.array([_item_of(item) for item in world.items], ITEM_DTYPE)
        for kart in self._reporting:
            action = self._race.get_kart_action(kart)
            karts[kart]["control"] = [float(getattr(action, name)) for name in CONTROLS]
        phase = self._phases.get(world.phase, Phase.RACE_PHASE)
        times = world.time, world.aux_ticks
        header = np.array([(*times, phase, len(karts), len(items), True)], HEADER_DTYPE)
        return Snapshot.of(header[0], karts, items)


def race_config(setup: RaceSetup, *, has_cameras: bool = False) -> Any:
    """Returns the ``pystk2.RaceConfig`` of a race.

    Args:
        setup: options of the race.
        has_cameras: use each kart's ``camera_mode``; otherwise no kart has a camera.
    """
    import pystk2

    config = pystk2.RaceConfig(
        num_kart=len(setup.karts),
        seed=setup.seed,
        difficulty=setup.difficulty,
        track=setup.track,
        laps=setup.laps,
    )
    config.mode = getattr(pystk2.RaceConfig.RaceMode, _GAME_MODES[setup.mode])
    config.reverse = setup.reverse
    config.step_size = setup.step_size
    # With another number, so many of the first karts get a camera, regardless of their
    # camera_mode. Without graphics, a camera crashes the game.
    config.num_cameras = 0
    config.players.clear()
    kinds = pystk2.PlayerConfig
    for kart in setup.karts:
        who = "AI_CONTROL" if kart.is_bot else "PLAYER_CONTROL"
        player = kinds(
            kart=kart.kart,
            name=plain_name(kart.name, _LONGEST_NAME),
            controller=getattr(kinds.Controller, who),
            camera_mode=kinds.CameraMode(kart.camera_mode if has_cameras else CameraMode.OFF),
            color=kart.color,
        )
        config.players.append(player)
    return config
