"""A moment of a race as a file: how the race began, and all that was done up to then."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version

import numpy as np
import numpy.typing as npt

from stkzoo._os import write_whole, write_zip
from stkzoo._reading import Unreadable, read_json, read_zip, reading
from stkzoo._schema import Count, typed
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import Session
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.env.grid import RaceRoster
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError, check_whole, shortened

_TYPE, _FORMAT = "stkzoo-scenario", 1
_ABOUT, _CONTROLS = "scenario.json", "controls.f4"
_MAX_MEMBER = {_ABOUT: 1 << 20, _CONTROLS: 256 << 20}
_MAX_STEPS = 1_000_000
_ENGINE = "PySuperTuxKart2"


@dataclass(frozen=True, slots=True)
class Scenario:
    """A moment of a race that can be reached again, here or elsewhere, bit for bit.

    Made by ``env.scenario()``, taken by ``reset(options={"scenario": ...})``. It holds no
    state of the game but the way to it, so that reaching it takes as long as the engine needs
    for the steps (a few milliseconds each).

    Attributes:
        setup: what the engine was told.
        kart_indices: each agent's kart, in grid order.
        agents: who was still racing.
        controls: ``(T, P, 7)`` float32: what the player karts did in each step.
        digest: of all karts at the moment, to check that it has been reached.
        engine: version of the engine.
        opponents: each opponent's kart, in grid order.
    """

    setup: RaceSetup
    kart_indices: tuple[Count, ...]
    agents: tuple[str, ...]
    controls: npt.NDArray[np.float32] = field(repr=False)
    digest: str
    engine: str = field(default_factory=lambda: version(_ENGINE))
    opponents: tuple[Count, ...] = ()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file, whole or not at all.

        Raises:
            ConfigError: it cannot be written.
        """
        names = ("kart_indices", "agents", "digest", "engine", "opponents")
        about = {"type": _TYPE, "format": _FORMAT, "setup": asdict(self.setup)}
        about |= {name: getattr(self, name) for name in names}
        members = {
            _ABOUT: json.dumps(about, indent=1).encode(),
            _CONTROLS: self.controls.astype("<f4").tobytes(),
        }
        with write_whole(path, "the scenario") as part:
            write_zip(part, members)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scenario:
        """Reads what :meth:`save` wrote.

        Raises:
            ConfigError: there is no such file, or it is damaged or of another kind.
        """
        expected = "a file that env.scenario().save(path) wrote"
        with reading(f"the scenario {path} cannot be read", expected):
            members = read_zip(path, _MAX_MEMBER)
            scenario = _read(members[_ABOUT], members[_CONTROLS])
            _check(scenario)
        return scenario

    def reach(self, session: Session) -> RaceStart:
        """Starts the race in a session and brings it to the moment.

        Raises:
            ConfigError: it was saved with another engine, whose races are not the same.
            EngineError: the game died or hangs.
        """
        begun = session.start(self.setup)
        snapshot = begun.snapshot
        for row in self.controls:
            snapshot = session.step(np.ascontiguousarray(row))
        if digest_of(snapshot) != self.digest:
            here = version(_ENGINE)
            raise ConfigError(
                f"the scenario on {self.setup.track!r} did not come out as it was saved, with "
                f"{_ENGINE} {self.engine}; here is {here}. Use that version and the same data of "
                "the game, or save the scenario again"
            )
        return replace(begun, snapshot=snapshot)

    @property
    def roster(self) -> RaceRoster:
        """Who races."""
        karts = self.setup.karts
        driven = (n for n, kart in enumerate(self.kart_indices) if karts[kart].is_bot)
        return RaceRoster(
            len(karts), len(self.kart_indices), frozenset(f"kart_{number}" for number in driven)
        )


def digest_of(snapshot: Snapshot) -> str:
    """A name for where all karts are and how they move."""
    seen = hashlib.blake2b(digest_size=16)
    for name in ("location", "rotation", "velocity"):
        seen.update(np.ascontiguousarray(snapshot.karts[name], "<f4").tobytes())
    return seen.hexdigest()


def _read(text: bytes, numbers: bytes) -> Scenario:
    about = read_json(text)
    if not isinstance(about, dict) or (about.get("type"), about.get("format")) != (_TYPE, _FORMAT):
        raise Unreadable(f"it is {shortened(about)}, expected a {_TYPE} of format {_FORMAT}")
    controls = np.frombuffer(numbers, "<f4").astype(np.float32)
    scenario = typed(Scenario, about | {"controls": controls})
    players = sum(not kart.is_bot for kart in scenario.setup.karts)
    if len(controls) % max(players * len(CONTROLS), 1) or (len(controls) and not players):
        raise Unreadable(f"{_CONTROLS} has {len(controls)} numbers, with {players} players")
    shape = -1 if players else 0, players, len(CONTROLS)
    return replace(scenario, controls=controls.reshape(shape))


def _check(scenario: Scenario) -> None:
    """Nothing reaches the engine that an environment would not have sent."""
    setup, controls = scenario.setup, scenario.controls
    if len(controls) > _MAX_STEPS or not np.isfinite(controls).all():
        raise Unreadable("controls are too many or not finite")
    low = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    if (controls < low).any() or (controls > 1.0).any():
        raise Unreadable("controls are out of range")
    options = {
        name: getattr(setup, name) for name in ("laps", "difficulty", "reverse", "step_size")
    }
    RaceOptions(num_kart=len(setup.karts), **options)
    if len(setup.starts) not in (0, len(setup.karts)):
        raise Unreadable("karts and starts do not fit")
    check_whole("seed", setup.seed, 0, 2**31 - 1)
    indices = (*scenario.kart_indices, *scenario.opponents)
    if len(set(indices)) != len(indices) or not set(indices) <= set(range(len(setup.karts))):
        raise Unreadable("the karts of agents or opponents are invalid")
