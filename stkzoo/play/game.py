"""A race in which a person drives the first kart."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from stkzoo._checks import check_name
from stkzoo._os import check_writable
from stkzoo.env.keyboard import keys_to_action
from stkzoo.errors import ConfigError
from stkzoo.evaluation import DemoRecorder, DemoView, save_demonstrations
from stkzoo.names import Phase, PowerupType
from stkzoo.play.screen import PlayScreen
from stkzoo.race import ActorMaker, Driver, RaceListener, RaceProgress, RaceResult, run_race
from stkzoo.race.result import versions_now
from stkzoo.render.renderer import BACKENDS, RaceRenderer
from stkzoo.views import VIEWS
from stkzoo.wrappers.camera import checked_size

#: Supported numbers of steps per second. A step is a whole number of game ticks of 1/60 s.
RATES = (10, 12, 15, 20, 30, 60)

#: The person drives the first agent.
_AGENT = "kart_0"
#: Ending of the names of datasets.
_ENDING = ".safetensors"


def play_race(
    opponents: Sequence[str | Driver] = ("ai", "ai", "ai"),
    *,
    name: str = "you",
    backend: str = "auto",
    size: Sequence[int] = (640, 480),
    rate: int = 20,
    view: str = "full",
    dataset: str | None = None,
    listeners: Sequence[RaceListener] = (),
    **settings: Any,
) -> RaceResult:
    """Opens a window, lets a person drive, and returns the result of the race.

    The race runs in real time. It is slower if rendering a frame takes longer than a step. Press
    Escape or close the window to end the race.

    Args:
        opponents: the other drivers (:func:`stkzoo.race.find_driver`).
        name: display name of the person.
        backend: renderer of the frames: ``"engine"``, the game; ``"map"``, a top-down map;
            ``"auto"``, the game if it can render on this machine, otherwise the map.
        size: width and height of a frame [pixels].
        rate: number of steps and frames per second, one of 10, 12, 15, 20, 30 and 60.
        view: view of the recorded observations and actions. Keys that have no action in the view do
            nothing.
        dataset: path of an ``.safetensors`` file to which the driving is recorded
            (:class:`DatasetWriter`); ``None`` to record nothing.
        listeners: further listeners of the race.
        settings: settings of the race; see :func:`stkzoo.race.run_race`.

    Raises:
        ConfigError: an argument is invalid, pygame is not installed, or there is no display.
        AgentError, AssetError, EngineError, RaceInterrupted: see :func:`stkzoo.race.run_race`.
    """
    _check(backend, rate, view)
    actions = keys_to_action(VIEWS[view], repr(view))
    with ExitStack() as resources:
        # Report bad paths before the window opens.
        writer = DatasetWriter(dataset, view, rate) if dataset is not None else None
        screen = PlayScreen(checked_size(size))
        resources.callback(screen.close)
        watchers = [_Game(screen, checked_size(size), backend, rate), *listeners]
        if writer is not None:
            watchers.append(writer)
        driver = Driver.of_actor(name, _person(screen, actions), view)
        return run_race([driver, *opponents], listeners=watchers, **settings)


def _check(backend: str, rate: int, view: str) -> None:
    check_name("backend", backend, BACKENDS)
    if rate not in RATES:
        raise ConfigError(
            f"rate is {rate!r}, expected one of {', '.join(map(str, RATES))} steps per second"
        )
    check_name("view", view, VIEWS)


def _person(screen: PlayScreen, actions: Mapping[Any, Any]) -> ActorMaker:
    """Returns a function that creates the person's actor, which reads the keys held down."""
    return lambda *_: lambda _: actions[tuple(sorted(screen.pressed)) or ""]


class DatasetWriter(DemoRecorder):
    """Writes the person's episode as demonstrations (:mod:`stkzoo.evaluation`) after the race.

    Args:
        path: path of the ``.safetensors`` file.
        view: name of a view with a fixed size that consists of stkzoo's wrappers.
        rate: number of steps per second.

    Raises:
        ConfigError: the path or the view is invalid, or the file exists.
    """

    def __init__(self, path: str, view: str, rate: int) -> None:
        self._path = Path(path)
        if self._path.suffix != _ENDING:
            raise ConfigError(f"the dataset is {path!r}, expected a path that ends in {_ENDING}")
        check_writable(path, "the dataset")
        if self._path.exists():  # a recording cannot be repeated
            raise ConfigError(f"the dataset {path!r} exists; choose another name, or delete it")
        super().__init__(1, DemoView(view), step_size=1 / rate)
        self._about: dict[str, Any] = {"view": view, "env_id": f"supertuxkart/{view}-v0"}

    def started(self, race: RaceProgress) -> None:
        """Records the observation on the grid and facts about the race."""
        super().started(race)
        options = race.env.options
        self._about |= {
            "agents": [{"label": race.names[_AGENT]}],
            "tracks": [race.race_info.track],
            "laps": options.laps,
            "num_kart": options.num_kart,
            "difficulty": options.difficulty,
            "step_size": options.step_size,
            "versions": versions_now(),
        }

    def ended(self, result: RaceResult) -> None:
        """Writes the file atomically.

        Raises:
            ConfigError: the file cannot be written.
        """
        super().ended(result)
        episodes = self.episodes(self._about)
        if episodes is not None:
            save_demonstrations(episodes, self._path)


class _Game(RaceListener):
    """The race listener that shows every step and keeps the race in real time."""

    def __init__(self, screen: PlayScreen, size: tuple[int, int], backend: str, rate: int) -> None:
        self._screen, self._seconds = screen, 1 / rate
        self._renderer = RaceRenderer(backend, size)
        self._due = 0.0

    def env_options(self) -> dict[str, Any]:
        """Returns the step size for the rate."""
        return {"step_size": self._seconds}

    def started(self, race: RaceProgress) -> None:
        """Shows the grid."""
        scene = race.scene
        self._kart = scene.kart_indices[race.env.possible_agents.index(_AGENT)]
        self._renderer.begin(scene)
        self._show(race)
        self._due = time.monotonic() + self._seconds
        self._wait(race)

    def stepped(self, race: RaceProgress) -> None:
        """Shows the step and waits until the next one is due."""
        self._show(race)
        # A late frame delays the race; later steps do not catch up.
        self._due = max(self._due + self._seconds, time.monotonic())
        self._wait(race)

    def closed(self) -> None:
        """Stops the render process."""
        self._renderer.close()

    def _wait(self, race: RaceProgress) -> None:
        self._screen.wait(self._due)
        while self._screen.is_paused and not self._screen.is_left:
            self._show(race, "paused: P continues   ")
            self._screen.wait(time.monotonic() + 0.1)
            self._due = time.monotonic()
        if self._screen.is_left:
            race.stop("left")

    def _show(self, race: RaceProgress, note: str = "") -> None:
        picture = self._renderer.pictures(race.snapshot)[self._kart]
        self._screen.show(picture, note + _status(race, self._kart))


def _status(race: RaceProgress, kart: int) -> str:
    snapshot, info = race.snapshot, race.infos[_AGENT]
    if info["finish_time"] > 0:
        return f"finished in {info['finish_time']:.2f} s, place {info['position']}"
    phase = Phase(snapshot.phase)
    if phase < Phase.RACE_PHASE:
        return {"READY_PHASE": "ready ...", "SET_PHASE": "set ..."}.get(phase.name, "go!")
    state, laps = snapshot.karts[kart], race.env.options.laps
    power = PowerupType(int(state["powerup_type"]))
    parts = [
        f"place {info['position']}/{len(snapshot.karts)}",
        f"lap {min(info['lap'] + 1, laps)}/{laps}",
        f"{snapshot.header['time']:.1f} s",
        f"{float(state['speed']) * 3.6:.0f} km/h",
        f"nitro {state['energy']:.0f}",
    ]
    if power != PowerupType.NOTHING:
        parts.append(f"{power.name.lower()} x{state['powerup_num']}")
    return "   ".join(parts)
