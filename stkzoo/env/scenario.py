"""Scenarios: a moment of a race as a file with the race's setup and all controls up to then."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from typing import Annotated

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from stkzoo._checks import check_type, check_whole
from stkzoo._os import write_whole, write_zip
from stkzoo._reading import Unreadable, read_json, read_zip, reading
from stkzoo._schema import Count
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import Session
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.env.grid import roster_of
from stkzoo.env.options import RaceOptions
from stkzoo.errors import ConfigError

_TYPE, _FORMAT = "stkzoo-scenario", 1
_ABOUT, _CONTROLS = "scenario.json", "controls.f4"
_MAX_MEMBER = {_ABOUT: 1 << 20, _CONTROLS: 256 << 20}
_MAX_STEPS = 1_000_000
_ENGINE = "PySuperTuxKart2"


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A moment of a race that can be replayed bit for bit, on this or another machine.

    ``env.scenario()`` makes it, and ``reset(options={"scenario": ...})`` accepts it. A scenario
    does not contain the game's state but the controls that lead to it, so reaching the moment takes
    the engine a few milliseconds per step.

    Attributes:
        setup: setup of the race in the engine.
        kart_indices: kart of each agent, in grid order.
        agents: agents that were still racing.
        digest: digest of all karts at the moment, for verification.
        controls: ``(T, P, 7)`` float32, controls of the P player karts in each of T steps.
        engine: version of the engine.
        opponents: kart of each opponent, in grid order.
    """

    setup: RaceSetup
    kart_indices: tuple[Count, ...]
    agents: tuple[str, ...]
    digest: str
    controls: npt.NDArray[np.float32] = field(
        repr=False, default_factory=lambda: np.zeros((0, 0, len(CONTROLS)), np.float32)
    )
    engine: str = field(default_factory=lambda: version(_ENGINE))
    opponents: tuple[Count, ...] = ()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the scenario to a file atomically.

        Args:
            path: path of the file.

        Raises:
            ConfigError: the file cannot be written.
        """
        names = ("kart_indices", "agents", "digest", "engine", "opponents")
        about = {"type": _TYPE, "format": _FORMAT, "setup": asdict(self.setup)}
        about |= {name: getattr(self, name) for name in names}
        about["num_steps"] = len(self.controls)  # without players, steps have no controls
        members = {
            _ABOUT: json.dumps(about, indent=1).encode(),
            _CONTROLS: self.controls.astype("<f4").tobytes(),
        }
        with write_whole(path, "the scenario") as part:
            write_zip(part, members)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scenario:
        """Reads a file that :meth:`save` wrote.

        Args:
            path: path of the file.

        Raises:
            ConfigError: the file does not exist, is damaged or is not a scenario.
        """
        expected = "a file that env.scenario().save(path) wrote"
        with reading(f"the scenario {path} cannot be read", expected):
            members = read_zip(path, _MAX_MEMBER)
            scenario = _read(members[_ABOUT], members[_CONTROLS])
            _check(scenario)
        return scenario

    def reach(self, session: Session) -> RaceStart:
        """Starts the race in a session and replays it up to the moment.

        Raises:
            ConfigError: the scenario was saved with another engine, which races differently.
            EngineError: the game crashed or hung.
        """
        begun = session.start(self.setup)
        snapshot = begun.snapshot
        for row in self.controls:
            snapshot = session.step(np.ascontiguousarray(row))
        if digest_of(snapshot) != self.digest:
            here = version(_ENGINE)
            raise ConfigError(
                f"the scenario on {self.setup.track!r} does not repeat as recorded with "
                f"{_ENGINE} {self.engine}; {here} is installed. Use that version and the same game "
                "data, or save the scenario again"
            )
        return replace(begun, snapshot=snapshot)

    def setup_with(self, opponents: Sequence[str]) -> RaceSetup:
        """Returns the setup with other names of the opponents.

        Args:
            opponents: names of the drivers that drive their karts from now on.
        """
        names = dict(zip(self.opponents, opponents, strict=True))
        karts = enumerate(self.setup.karts)
        renamed = [replace(kart, name=names.get(number, kart.name)) for number, kart in karts]
        return replace(self.setup, karts=tuple(renamed))

    @property
    def roster(self) -> str:
        """Karts and agents of the race, in words."""
        karts = self.setup.karts
        ai_agents = {f"kart_{n}" for n, kart in enumerate(self.kart_indices) if karts[kart].is_bot}
        return roster_of(len(karts), len(self.kart_indices), ai_agents, bool(self.opponents))


def read_scenario(choice: object) -> Scenario:
    """Returns a scenario, or that of a file.

    Raises:
        ConfigError: the choice is neither, or the file cannot be read.
    """
    if isinstance(choice, (str, os.PathLike)):
        return Scenario.load(choice)
    expected = "a Scenario or the path of its file"
    scenario: Scenario = check_type("scenario", choice, Scenario, expected)
    return scenario


def digest_of(snapshot: Snapshot) -> str:
    """Returns a digest of the positions and movement of all karts."""
    seen = hashlib.blake2b(digest_size=16)
    for name in ("location", "rotation", "velocity"):
        seen.update(np.ascontiguousarray(snapshot.karts[name], "<f4").tobytes())
    return seen.hexdigest()


@dataclass(frozen=True, slots=True)
class _ScenarioHead:
    """What a scenario's JSON contains besides its fields; players' controls show their steps."""

    type: str
    format: int
    num_steps: Annotated[int, Meta(ge=0, le=_MAX_STEPS)] = 0


def _read(text: bytes, numbers: bytes) -> Scenario:
    head = read_json(text, _ScenarioHead)
    if (head.type, head.format) != (_TYPE, _FORMAT):
        raise Unreadable(
            f"it is a {head.type[:40]} of format {head.format}, expected a {_TYPE} of format "
            f"{_FORMAT}"
        )
    scenario = read_json(text, Scenario)
    controls = np.frombuffer(numbers, "<f4").astype(np.float32)
    players = sum(not kart.is_bot for kart in scenario.setup.karts)
    if len(controls) % max(players * len(CONTROLS), 1) or (len(controls) and not players):
        raise Unreadable(f"{_CONTROLS} has {len(controls)} numbers, with {players} players")
    num_steps = -1 if players else head.num_steps
    return replace(scenario, controls=controls.reshape(num_steps, players, len(CONTROLS)))


def _check(scenario: Scenario) -> None:
    """Rejects values that an environment would not send to the engine."""
    setup, controls = scenario.setup, scenario.controls
    if len(controls) > _MAX_STEPS or not np.isfinite(controls).all():
        raise Unreadable("there are too many controls, or a control is not finite")
    low = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    if (controls < low).any() or (controls > 1.0).any():
        raise Unreadable("controls are out of range")
    names = "laps", "difficulty", "reverse", "mode", "step_size"
    RaceOptions(num_kart=len(setup.karts), **{name: getattr(setup, name) for name in names})
    if len(setup.starts) not in (0, len(setup.karts)):
        raise Unreadable(f"there are {len(setup.starts)} starts for {len(setup.karts)} karts")
    check_whole("seed", setup.seed, 0, 2**31 - 1)
    indices = (*scenario.kart_indices, *scenario.opponents)
    if len(set(indices)) != len(indices) or not set(indices) <= set(range(len(setup.karts))):
        raise Unreadable("the karts of agents or opponents are invalid")
