"""The libraries that engine processes load first: with them, races are the same, and faster."""

import contextlib
import ctypes
import hashlib
from pathlib import Path

import numpy as np
import pytest

from stkzoo.engine import process
from stkzoo.engine.assets import find_assets
from stkzoo.engine.process import LIBM, SHORTCUTS
from stkzoo.engine.session import WorkerSession
from stkzoo.engine.setup import KartSetup, RaceSetup

pytestmark = pytest.mark.skipif(not LIBM.exists(), reason="needs Linux")
#: Digests of the results of glibc 2.36 for :func:`inputs`.
RESULTS = {
    "acosf": "014ecd37f293d756",
    "asinf": "0ee947495ed1eaf5",
    "atanf": "df5e1e690cad14d6",
    "atan2f": "89c7ffa9d8658630",
}


def function(library, name):
    found = ctypes.CDLL(library)[name]
    found.argtypes = [ctypes.c_float] * (2 if name == "atan2f" else 1)
    found.restype = ctypes.c_float
    return found


def inputs(name):
    """Bits of all kinds, values near one, and special values."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, 50_000, np.uint32).view(np.float32)
    special = np.float32([0, -0.0, 1, -1, np.inf, -np.inf, np.nan, 1e-45, 3e38, 0.5, -0.5])
    numbers = np.concatenate([bits, rng.uniform(-2, 2, 50_000).astype(np.float32), special])
    if name != "atan2f":
        return (numbers,)
    pairs = np.meshgrid(special, special)
    return tuple(np.concatenate([rng.permutation(numbers), one.ravel()]) for one in pairs)


def results(library, name):
    call, arrays = function(library, name), (column.tolist() for column in inputs(name))
    found = np.float32([call(*numbers) for numbers in zip(*arrays, strict=True)])
    found[np.isnan(found)] = np.nan  # of one kind
    return found


@pytest.mark.parametrize("name", RESULTS)
def test_results_do_not_depend_on_the_system(name):
    found = results(LIBM, name)
    assert hashlib.sha256(found.tobytes()).hexdigest()[:16] == RESULTS[name]


def run_race(track, steps):
    """Runs a race against the game's AI; returns the memory map of its process and a digest."""
    karts = (KartSetup(is_bot=False), *[KartSetup()] * 5)
    with contextlib.closing(WorkerSession(find_assets().root)) as session:
        session.start(RaceSetup(track, karts, seed=5))
        digest = hashlib.sha256()
        for _ in range(steps):
            digest.update(session.step(np.eye(1, 7, dtype=np.float32)).karts.tobytes())
        return Path(f"/proc/{session.pid}/maps").read_text(), digest.hexdigest()


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_the_process_of_a_race_loads_them(monkeypatch, method):
    monkeypatch.setenv("STKZOO_START_METHOD", method)
    libraries, _ = run_race("olivermath", 1)
    assert f"{LIBM}\n" in libraries
    assert f"{SHORTCUTS}\n" in libraries


@pytest.mark.slow
@pytest.mark.parametrize("track", ["lighthouse", "hacienda", "cocoa_temple", "black_forest"])
def test_faster_functions_of_the_engine_give_the_same_race(monkeypatch, track):
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")  # no process that already has them
    libraries, digest = run_race(track, 200)
    assert SHORTCUTS.name in libraries
    monkeypatch.setattr(process, "_ENGINE_VERSION", "another")
    libraries, expected = run_race(track, 200)
    assert SHORTCUTS.name not in libraries
    assert digest == expected
