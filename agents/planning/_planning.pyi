from typing import Any

import numpy as np
import numpy.typing as npt

def age_memory(
    rules: npt.NDArray[np.float64],
    memory: npt.NDArray[np.float32],
    speed: npt.NDArray[np.float32],
    skeed_factor: npt.NDArray[np.float32],
) -> None: ...
def present_plans(
    rules: npt.NDArray[np.float64],
    logits: tuple[npt.NDArray[Any], ...],
    memory: npt.NDArray[np.float32],
    own: tuple[npt.NDArray[Any], ...],
    best: npt.NDArray[np.float32],
    scene: npt.NDArray[np.float32],
    rivals: npt.NDArray[np.float64],
    prior: npt.NDArray[np.float32],
    inputs: npt.NDArray[np.float32],
    first: int,
) -> None: ...
def survey_road(
    rules: npt.NDArray[np.float64],
    worths: npt.NDArray[np.float32],
    memory: npt.NDArray[np.float32],
    own: tuple[npt.NDArray[Any], ...],
    around: tuple[npt.NDArray[Any], ...],
    before: tuple[npt.NDArray[Any], ...],
    now: tuple[npt.NDArray[Any], ...],
    out: tuple[npt.NDArray[Any], ...],
) -> None: ...
def weigh_plans(
    table: tuple[npt.NDArray[Any], ...],
    rules: npt.NDArray[np.float64],
    motion: tuple[npt.NDArray[Any], ...],
    rows: npt.NDArray[np.intp],
    karts: npt.NDArray[np.float32],
    road: npt.NDArray[np.float32],
    items: npt.NDArray[np.float64],
    rivals: npt.NDArray[np.float64],
    out: npt.NDArray[np.float32],
) -> None: ...
def write_memory(
    rules: npt.NDArray[np.float64],
    memory: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
    first: int,
) -> None: ...
