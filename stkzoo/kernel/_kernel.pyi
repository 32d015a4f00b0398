from typing import Any

import numpy as np
import numpy.typing as npt

class View:
    def __new__(
        cls,
        names: tuple[str, ...],
        items: int = -1,
        karts: int = -1,
        paths: int = -1,
        polar: bool = False,
        flat: bool = False,
    ) -> View: ...
    def observe(self, *scene_and_who: Any) -> list[Any] | None: ...
    def observe_into(self, *scene_who_and_rows: Any) -> bool: ...

class Controls:
    def __new__(
        cls, names: tuple[str, ...], leaves: tuple[Any, ...], num_columns: int
    ) -> Controls: ...
    def read(
        self, actions: list[Any], rows: npt.NDArray[np.intp], controls: npt.NDArray[np.float32]
    ) -> bool: ...

def copy_fields(
    block: bytes,
    starts: npt.NDArray[np.intp],
    records: npt.NDArray[np.void],
    plan: npt.NDArray[np.int32],
) -> None: ...
def copy_attributes(
    objects: list[Any],
    names: tuple[str, ...],
    records: npt.NDArray[np.void],
    plan: npt.NDArray[np.int32],
) -> None: ...
def set_actions(
    actions: list[Any],
    names: tuple[str, ...],
    controls: npt.NDArray[np.float32],
    present: npt.NDArray[np.float32],
) -> None: ...
def score(
    before: npt.NDArray[np.void],
    after: npt.NDArray[np.void],
    race_length: float,
    terms: npt.NDArray[np.intp],
    weights: npt.NDArray[np.float64],
    columns: npt.NDArray[np.intp],
    rows: npt.NDArray[np.intp],
    karts: npt.NDArray[np.intp],
    last: npt.NDArray[np.float64],
) -> None: ...
def make_infos(
    keys: tuple[str, ...],
    karts: npt.NDArray[np.void],
    last: npt.NDArray[np.float64],
    sums: npt.NDArray[np.float64],
    length: int,
    rows: npt.NDArray[np.intp],
    kart_of_row: npt.NDArray[np.intp],
) -> list[dict[str, Any]]: ...
def add_up(
    last: npt.NDArray[np.float64], sums: npt.NDArray[np.float64], rows: npt.NDArray[np.intp]
) -> list[float]: ...
def finished(karts: npt.NDArray[np.void], who: npt.NDArray[np.intp]) -> list[bool]: ...
def layouts() -> dict[str, dict[str, int]]: ...
def join_rows(rows: tuple[Any, ...]) -> bytes | None: ...
