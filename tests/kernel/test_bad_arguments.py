"""The kernel accepts or refuses bad arguments and never accesses memory outside its arrays.

``make sanitize`` runs these tests with a kernel that stops the program at the first such access.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import struct
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from stkzoo import RaceVectorEnv, kernel, race_v0
from stkzoo.drivers.messages import encode_observation
from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, KART_DTYPE
from stkzoo.engine.track import decode_track
from stkzoo.wrappers.racing import LOOKS, racing_features
from stkzoo.wrappers.racing.wrapper import _writer, racing_view_of
from tests import oracle
from tests.kernel.test_kernel import USERS
from tests.kernel.test_mlp import inputs_of, layers_of
from tests.support.bad_arguments import check_bad_calls, check_lists_are_refused

VIEWS = ("full", "masked_discrete", "flattened_control", "racing", "simple")
#: Size of the item count and one item in the engine's block [bytes].
ITEM_SIZE = 4 + 33


# ------------------------------------------------------------------ valid calls, recorded in races


class Recorder:
    """Replaces a class or function of the kernel and records the arguments of its calls."""

    def __init__(self, name, cases):
        self._made, self._name, self._cases = getattr(kernel, name), name, cases

    def __call__(self, *args, **kwargs):
        args = tuple(getattr(a, "made", a) for a in args)
        made = self._made(*args, **kwargs)
        if not isinstance(self._made, type):
            self._cases[self._name].append((args, kwargs, None, ()))
            return made
        return Recorded(made, lambda *call: self._cases[self._name].append((args, kwargs, *call)))


class Recorded:
    """An object of the kernel whose method calls are recorded."""

    def __init__(self, made, keep):
        self.made, self._keep = made, keep

    def __getattr__(self, name):
        def call(*args):
            args = tuple(getattr(a, "made", a) for a in args)
            self._keep(name, args)
            return getattr(self.made, name)(*args)

        return call


@pytest.fixture(scope="module")
def cases():
    """Records calls by name: the constructor's arguments, and a method with its arguments."""
    kept = {name: [] for name in (*oracle.__all__, "GameStepper")}
    with pytest.MonkeyPatch.context() as patch:
        for user, names in USERS.items():
            importlib.import_module(f"stkzoo.{user}")
            for name in names:
                patch.setattr(f"stkzoo.{user}.{name}", Recorder(name, kept))
        for cache in (decode_track, racing_view_of, _writer):
            cache.cache_clear()
        drive_races()
        encode_observation({"rows": (np.arange(3.0), np.arange(3.0))})
        for cache in (decode_track, racing_view_of, _writer):
            cache.cache_clear()
    layers, rows = layers_of(0, (5, 3, 2)), (inputs_of(0, 4, 6), np.empty((4, 2), np.float32))
    kept["Mlp"] = [((layers, is_tanh), {}, "evaluate", rows) for is_tanh in (True, False)]
    kept["GameStepper"] = [
        (stepper_arguments(), {}, "step", (np.ones((2, 7), np.float32),)),
        (stepper_arguments(), {}, "read", (True,)),
    ]
    return kept


def drive_races():
    for view in VIEWS:
        options = {"num_kart": 3, "track": "lighthouse", "view": view, "events": True}
        with race_v0.parallel_env(**options, opponents=["pursuit"], agents=2) as env:
            env.reset(seed=1)
            for _ in range(3):
                env.step({agent: env.action_space(agent).sample() for agent in env.agents})
            view = racing_view_of(env.track_map)
            seen = [env.snapshot], [0], [np.arange(3)]
            racing_features(*view.surroundings(*seen))
            view.road(*seen, LOOKS)
    for view in VIEWS[1:]:
        options = {"num_kart": 3, "track": "lighthouse", "view": view, "events": True}
        with contextlib.closing(RaceVectorEnv(1, **options, prefetch=False)) as envs:
            envs.reset(seed=1)
            envs.step(envs.action_space.sample())


def stepper_arguments():
    """Returns a stub engine for the kernel: two players, and a block with two karts and an item."""
    kart = struct.pack("<?ii", True, 0, 1) + struct.pack("<i3si3s", 3, b"abc", 3, b"gnu")
    kart += b"".join(struct.pack("<ii", 1, n) + bytes(4 * n) for n in (3, 4, 3, 3, 3, 3))
    kart += bytes(66)
    item = bytes(5) + struct.pack("<ii", 1, 3) + bytes(12 + 8)
    block = struct.pack("<fi", 0.5, 2) + bytes(12) + struct.pack("<i", 2) + 2 * kart
    block += struct.pack("<i", 1) + item
    point = SimpleNamespace(speed=1.0, angular_velocity=(0.0, 1.0, 2.0))
    world = SimpleNamespace(
        karts=[point, point], phase="go", time=0.5, aux_ticks=3.0, update=lambda: None
    )
    world.block = block
    world.__getstate__ = lambda: (world.block,)
    race = SimpleNamespace(
        step=lambda *_: True,
        get_kart_action=lambda _: SimpleNamespace(**dict.fromkeys(CONTROLS, 0.0)),
    )
    actions = [SimpleNamespace(), SimpleNamespace()]
    return race, world, actions, CONTROLS, {"go": 2}, 3, (1,)


#: Methods that write into the caller's arrays.
ROWS = {
    "ActionReader": "read_batch",
    "KartObserver": "observe_into",
    "RacingObserver": "observe",
    "StepScorer": "score_into infos_into",
}


@pytest.mark.parametrize("name", ROWS)
def test_races_call_the_methods_that_write_into_arrays(cases, name):
    assert {*ROWS[name].split()} <= {method for _, _, method, _ in cases[name]}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*oracle.__all__, "GameStepper"])
def test_bad_arguments_are_accepted_or_refused(cases, name):
    assert cases[name], "no race has called it"
    check_bad_calls(getattr(kernel, name), cases[name])


# ------------------------------------------------------------------ earlier defects


def test_controls_can_be_unaligned():
    race, world, actions, *rest = stepper_arguments()
    stepper = kernel.GameStepper(race, world, actions, *rest)
    controls = np.arange(14, dtype=np.float32)
    stepper.step(memoryview(b"??????" + controls.tobytes())[6:])
    assert [action.acceleration for action in actions] == [0.0, 7.0]


@pytest.mark.parametrize("place", [0, 1])
def test_an_engine_without_a_method_is_refused(place):
    arguments = list(stepper_arguments())
    arguments[place] = SimpleNamespace()
    with pytest.raises(AttributeError):
        kernel.GameStepper(*arguments)


def test_a_block_with_too_few_items_is_refused():
    race, world, *rest = stepper_arguments()
    stepper = kernel.GameStepper(race, world, *rest)
    world.block = world.block[:-ITEM_SIZE] + struct.pack("<i", 2**31 - 1)
    with pytest.raises(ValueError, match="too short for its items"):
        stepper.read(True)


@pytest.mark.parametrize("place", [float("nan"), float("inf"), 1e30])
def test_a_kart_with_an_invalid_location_can_be_observed(cases, place):
    observed = (case for case in cases["RacingObserver"] if case[2] == "observe")
    args, _, _, (data, road, who, out) = next(observed)
    karts = np.frombuffer(data, KART_DTYPE, len(who), HEADER_DTYPE.itemsize).copy()
    karts["location"] = place
    start, end = HEADER_DTYPE.itemsize, HEADER_DTYPE.itemsize + karts.nbytes
    kernel.RacingObserver(*args).observe(
        data[:start] + karts.tobytes() + data[end:], road, who, out
    )


def test_a_table_without_rows_is_refused():
    with pytest.raises(ValueError, match="row for each whole number"):
        kernel.ActionReader((), (((0.0, -1.0, True, 0, np.zeros(7, np.float32)),),), 7)


def test_a_conversion_can_clear_the_actions():
    class Dropping(int):
        def __float__(self):
            actions.clear()
            return 1.0

    actions = {"kart_0": {"first": Dropping(1), "second": 1}}
    leaves = tuple(((0.0, 1.0, True, column, None),) for column in range(2))
    reader = kernel.ActionReader(("first", "second"), leaves, 2)
    controls = np.zeros(2, np.float32)
    assert reader.read(actions, ("kart_0",), np.zeros(1, np.intp), controls)
    assert controls.tolist() == [1.0, 1.0]


#: A conversion that fails after it has removed the last reference to its number.
CLEARING = """
import numpy as np
from stkzoo import kernel

class Clearing(int):
    def __float__(self):
        action.clear()
        return "not a number"

action = {"first": Clearing(1), "second": 1}
leaves = tuple(((0.0, 1.0, True, column, None),) for column in range(2))
reader = kernel.ActionReader(("first", "second"), leaves, 2)
controls = np.zeros(2, np.float32)
print(reader.read({"kart_0": action}, ("kart_0",), np.zeros(1, np.intp), controls))
"""


def test_a_conversion_can_clear_its_own_action():
    answer = subprocess.run(
        [sys.executable, "-c", CLEARING],
        env={**os.environ, "PYTHONMALLOC": "debug"},  # overwrites freed memory
        capture_output=True,
        text=True,
    )
    assert (answer.returncode, answer.stdout) == (0, "False\n"), answer.stderr


def test_arrays_in_a_list_are_refused(cases):
    for args, _, method, values in {case[2]: case for case in cases["RacingObserver"]}.values():
        assert check_lists_are_refused(kernel.RacingObserver, args)
        check_lists_are_refused(getattr(kernel.RacingObserver(*args), method), values)


def test_negative_numbers_of_choices_are_refused():
    joined = np.array([10, -5])
    with pytest.raises(ValueError, match="too few or many values"):
        kernel.KartObserver(("phase", "jumping"), 0, 0, 0, flat=True, joined=joined)


def test_names_must_be_strings():
    with pytest.raises(ValueError, match="text"):
        kernel.KartObserver((1,))


def test_entries_must_be_tuples():
    with pytest.raises(ValueError, match="an entry must be a tuple"):
        kernel.ActionReader((), ((None,),), 7)
