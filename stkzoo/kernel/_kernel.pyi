from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

class GameStepper:
    def __new__(
        cls,
        race: Any,
        world: Any,
        actions: list[Any],
        controls: tuple[str, ...],
        phases: dict[Any, int],
        last_phase: int,
        reporting: tuple[int, ...],
    ) -> GameStepper: ...
    def step(self, controls: bytes | npt.NDArray[np.float32]) -> bytes: ...
    def read(self, is_running: bool) -> bytes: ...
    def serve(self, fd: int) -> bytes: ...

class TrackGraph:
    def __new__(
        cls,
        nodes: npt.NDArray[np.float32],
        widths: npt.NDArray[np.float32],
        distances: npt.NDArray[np.float32],
        begins: npt.NDArray[np.intp],
        successors: npt.NDArray[np.intp],
        length: float,
    ) -> TrackGraph: ...
    def ahead(self, node: int) -> npt.NDArray[np.intp]: ...

class KartObserver:
    def __new__(
        cls,
        names: tuple[str, ...],
        items: int = -1,
        karts: int = -1,
        paths: int = -1,
        polar: bool = False,
        flat: bool = False,
        joined: npt.NDArray[np.intp] | None = None,
        nitro: npt.NDArray[np.bool_] | None = None,
        fire: npt.NDArray[np.bool_] | None = None,
    ) -> KartObserver: ...
    def observe(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: npt.NDArray[np.intp],
    ) -> list[Any]: ...
    def observe_into(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        batch: Any,
    ) -> None: ...

class RacingObserver:
    def __new__(
        cls,
        roads: tuple[tuple[npt.NDArray[np.float32], ...], ...],
        tables: tuple[npt.NDArray[np.float32], npt.NDArray[np.int8], npt.NDArray[np.int8]],
        counts: tuple[int, int, int, int, int, int],
        lengths: tuple[float, float, float, float, float, float],
    ) -> RacingObserver: ...
    def observe(
        self,
        data: bytes,
        road: int,
        who: npt.NDArray[np.intp],
        out: npt.NDArray[np.float32],
        rows: npt.NDArray[np.intp] = ...,
    ) -> None: ...
    def look(
        self,
        data: bytes,
        road: int,
        who: npt.NDArray[np.intp],
        looks: npt.NDArray[np.float32],
        numbers: tuple[npt.NDArray[np.float32], ...],
        kinds: tuple[npt.NDArray[np.int64], ...],
        around: tuple[npt.NDArray[Any], ...],
    ) -> None: ...
    def trace(
        self,
        data: bytes,
        road: int,
        who: npt.NDArray[np.intp],
        looks: npt.NDArray[np.float32],
        out: npt.NDArray[np.float32],
    ) -> None: ...
    def write(
        self,
        numbers: tuple[npt.NDArray[Any], ...],
        kinds: tuple[npt.NDArray[Any], ...],
        around: tuple[npt.NDArray[Any], ...],
        out: npt.NDArray[np.float32],
    ) -> None: ...

class Mlp:
    def __new__(
        cls,
        layers: tuple[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]], ...],
        is_tanh: bool,
    ) -> Mlp: ...
    def evaluate(self, inputs: npt.NDArray[np.float32], out: npt.NDArray[np.float32]) -> None: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

class ActionReader:
    def __new__(
        cls, names: tuple[str, ...], leaves: tuple[Any, ...], num_columns: int
    ) -> ActionReader: ...
    def read(
        self,
        actions: Any,
        agents: tuple[str, ...],
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
    ) -> bool: ...
    def read_batch(
        self,
        batch: Any,
        count: int,
        slots: npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
    ) -> bool: ...

class CarController:
    def __new__(
        cls,
        act: Callable[..., Any],
        kinds: tuple[bool, bool, bool],
        limits: tuple[float, ...],
        pedals: npt.NDArray[np.float64],
        columns: tuple[int, int, int],
        num_columns: int,
    ) -> CarController: ...
    def drive(
        self,
        controls: npt.NDArray[np.float32],
        rows: npt.NDArray[np.intp],
        data: bytes,
        karts: npt.NDArray[np.intp],
        states: npt.NDArray[np.float64],
        places: npt.NDArray[np.intp],
    ) -> None: ...

class EventCounter:
    def __new__(
        cls,
        nodes: npt.NDArray[np.float32],
        step_size: float,
        memory: npt.NDArray[np.float64],
        counts: npt.NDArray[np.float64],
    ) -> EventCounter: ...
    def count(self, before: bytes, after: bytes) -> None: ...

class StepScorer:
    def __new__(
        cls,
        agents: tuple[str, ...],
        karts: npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        last: npt.NDArray[np.float64],
        sums: npt.NDArray[np.float64],
        keys: tuple[str, ...],
        race_length: float,
        rewards: tuple[Any, ...],
        events: npt.NDArray[np.float64],
    ) -> StepScorer: ...
    def score(
        self, before: bytes, after: bytes, is_over: bool
    ) -> tuple[dict[str, float], dict[str, bool], dict[str, bool]]: ...
    def score_into(
        self,
        before: bytes,
        after: bytes,
        is_over: bool,
        slots: npt.NDArray[np.intp],
        rewards: npt.NDArray[np.float64],
        terminations: npt.NDArray[np.bool_],
        truncations: npt.NDArray[np.bool_],
    ) -> None: ...
    def infos(self, data: bytes, length: int) -> dict[str, dict[str, Any]]: ...
    def infos_into(
        self,
        data: bytes,
        length: int,
        slots: npt.NDArray[np.intp],
        table: npt.NDArray[np.float64],
    ) -> None: ...

def reward_term(
    name: str, before: bytes, after: bytes, race_length: float
) -> npt.NDArray[np.float64]: ...
def layouts() -> list[tuple[str, int]]: ...
def action_mask(
    nitro: npt.NDArray[np.bool_],
    fire: npt.NDArray[np.bool_],
    energy: npt.NDArray[np.float32],
    powerup_types: npt.NDArray[np.int64],
) -> npt.NDArray[np.int8]: ...
def to_polar(points: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]: ...
def join_rows(rows: tuple[Any, ...]) -> bytes | None: ...
def trace_roads(
    starts: tuple[Any, ...],
    ends: tuple[Any, ...],
    widths: tuple[Any, ...],
    most: int,
    rules: npt.NDArray[np.float64],
    lines: npt.NDArray[np.float32],
    first: npt.NDArray[np.float32],
) -> None: ...
def look_along(
    lines: npt.NDArray[np.float32],
    spacing: float,
    first: npt.NDArray[np.float32],
    looks: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
) -> None: ...
def stack_vectors(rows: tuple[Any, ...], blank: float, out: npt.NDArray[np.float32]) -> None: ...
