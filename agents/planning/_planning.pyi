from typing import Any

import numpy as np
import numpy.typing as npt

def age_memory(
    rules: npt.NDArray[np.float64],
    memory: npt.NDArray[np.float32],
    speed: npt.NDArray[np.float32],
    skeed_factor: npt.NDArray[np.float32],
) -> None: ...
def compute_layer(
    matrix: npt.NDArray[np.float32],
    bias: npt.NDArray[np.float32],
    activation: int,
    inputs: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
) -> None: ...
def plan_karts(
    plans: tuple[Any, ...],
    memory: npt.NDArray[np.float32],
    around: tuple[npt.NDArray[Any], ...],
    line: npt.NDArray[np.float32] | None,
    moments: npt.NDArray[np.float32] | None,
    out: tuple[npt.NDArray[np.float32], ...],
    first: int,
) -> None: ...
def write_memory(
    rules: npt.NDArray[np.float64],
    memory: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32],
    first: int,
) -> None: ...
