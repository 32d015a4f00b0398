"""The kernel accepts or refuses bad arguments and never accesses memory outside its arrays.

``make sanitize`` runs these tests with a kernel that stops the program at the first such access.
"""

from __future__ import annotations

import contextlib
import os
import struct
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from stkzoo import RaceVectorEnv, kernel, race_v0
from stkzoo.drivers.messages import encode_observation
from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.wrappers.racing import racing_features, road_observer
from tests.support.bad_arguments import check_bad_calls, check_lists_are_refused
from tests.support.kernel_users import USERS, replaced_kernel
from tests.support.views import marked

VIEWS = ("full", "masked_discrete", "flattened_control", "contest", "simple")
#: Size of the item count and one item in the engine's block [bytes].
ITEM_SIZE = 4 + 33


NAMES = sorted({*(name for names in USERS.values() for name in names), "GameStepper"})

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
    kept = {name: [] for name in NAMES}
    recorders = {name: Recorder(name, kept) for name in NAMES}
    with pytest.MonkeyPatch.context() as patch, replaced_kernel(patch, recorders):
        drive_races()
        encode_observation({"rows": (np.arange(3.0), np.arange(3.0))})
    points = np.ones((2, 3), np.float32)
    kept["to_polar"] = [((points,), {}, None, ())]
    kept["new_batch"] = [((batch_of(), 3), {}, None, ())]
    kept["split_batch"] = [((batch_of(), ("a", "b")), {}, None, ())]
    kept["action_mask"] = [((0.0, 1, np.stack([FLAGS, FLAGS])), {}, None, ())]
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
            racing_features(road_observer(env.track_map).surroundings(env.snapshot, np.arange(3)))
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
    functions = race.step, race.get_kart_action, world.update, world.__getstate__
    return functions, world, actions, CONTROLS, {"go": 2}, 3, (1,), TWO


@pytest.mark.slow
@pytest.mark.parametrize("name", marked(NAMES, ["ActionReader", "KartObserver"]))
def test_bad_arguments_are_accepted_or_refused(cases, name):
    assert cases[name], "no race has called it"
    check_bad_calls(getattr(kernel, name), cases[name])


# ------------------------------------------------------------------ one case per class


def snapshot_of(num_kart=2, num_items=2, node=0):
    karts = np.zeros(num_kart, KART_DTYPE)
    karts["node"] = node
    return Snapshot.of(np.zeros((), HEADER_DTYPE), karts, np.zeros(num_items, ITEM_DTYPE)).data


FLAGS = np.array([True, False])
KARTS = snapshot_of()
FIRST, TWO = np.zeros(1, np.intp), np.arange(2)


def track_of(*successors, nodes=6):
    begins = np.cumsum([0, *map(len, successors)]).astype(np.intp)
    ends = np.array([node for nodes in successors for node in nodes], np.intp)
    count = len(successors)
    sizes = nodes * count, count, 2 * count
    return kernel.TrackGraph(*(np.zeros(n, np.float32) for n in sizes), begins, ends, 20.0)


def batch_of(**changes):
    return {
        "kart_type": [""] * 4,
        "energy": np.ones((4, 1), np.float32),
        "items_type": np.ones((4, 3), np.int64),
        "items_mask": np.ones((4, 3), np.int8),
    } | changes


def observe_into(batch, *, paths=1, data=KARTS, who=TWO, rows=np.array([3, 1])):  # noqa: B008
    names = "kart_type", "energy", "items_type", "items_mask"
    observer = kernel.KartObserver(tuple((name, name, 0) for name in names), items=3)
    observer.observe_into(track_of([0]), paths, ("tux", "gnu"), data, who, rows, batch)


def test_only_the_given_rows_are_written():
    batch = batch_of()
    observe_into(batch)
    assert batch["kart_type"] == ["", "gnu", "", "tux"]
    assert batch["energy"][:, 0].tolist() == [1, 0, 1, 0]
    assert batch["items_mask"][[0, 3]].tolist() == [[1, 1, 1], [1, 1, 0]]


def read_only(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"energy": np.ones((4, 1))}, "float32"),
        ({"energy": read_only(np.ones((4, 1), np.float32))}, "writeable"),
        ({"energy": np.ones((4, 1), np.dtype("f4").newbyteorder("S"))}, "native-endian"),
        ({"energy": np.ones((4, 2), np.float32)}, "the wrong number of energy"),
        ({"items_mask": np.ones((4, 3), np.int8)[::-1]}, "contiguous"),
        ({"kart_type": ()}, "names of a batch must be a list"),
        ({"energy": None}, "float32"),
    ],
)
def test_arrays_of_another_form_are_refused(changes, message):
    with pytest.raises((TypeError, ValueError), match=message):
        observe_into(batch_of(**changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data": KARTS[:-1]}, "not a snapshot"),
        ({"data": snapshot_of(node=1)}, "there is no segment"),
        ({"paths": 2}, "2 of 1 segments"),
        ({"who": TWO + 1}, "a kart index"),
        ({"who": FIRST}, "1 karts for 2 rows"),
        ({"rows": np.array([4, 1])}, "row index"),
        ({"rows": np.array([-1, 1])}, "row index"),
    ],
)
def test_indices_and_snapshots_out_of_range_are_refused(changes, message):
    with pytest.raises((IndexError, ValueError), match=message):
        observe_into(batch_of(), **changes)


# ------------------------------------------------------------------ earlier defects


def test_controls_can_be_unaligned():
    functions, world, actions, *rest = stepper_arguments()
    stepper = kernel.GameStepper(functions, world, actions, *rest)
    controls = np.arange(14, dtype=np.float32)
    stepper.step(memoryview(b"??????" + controls.tobytes())[6:])
    assert [action.acceleration for action in actions] == [0.0, 7.0]


def test_a_block_with_too_few_items_is_refused():
    functions, world, *rest = stepper_arguments()
    stepper = kernel.GameStepper(functions, world, *rest)
    world.block = world.block[:-ITEM_SIZE] + struct.pack("<i", 2**31 - 1)
    with pytest.raises(ValueError, match="too short for its items"):
        stepper.read()


@pytest.mark.slow
@pytest.mark.parametrize("place", [float("nan"), float("inf"), 1e30])
def test_a_kart_with_an_invalid_location_can_be_observed(cases, place):
    road, data, who, looks, around = cases["look_around"][0][0]
    karts = np.frombuffer(data, KART_DTYPE, len(who), HEADER_DTYPE.itemsize).copy()
    karts["location"] = place
    start, end = HEADER_DTYPE.itemsize, HEADER_DTYPE.itemsize + karts.nbytes
    kernel.look_around(road, data[:start] + karts.tobytes() + data[end:], who, looks, around)


def test_a_table_without_rows_is_refused():
    with pytest.raises(ValueError, match="row for each whole number"):
        kernel.ActionReader((), (((0.0, -1.0, True, 0, np.zeros(7, np.float32)),),))


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
reader = kernel.ActionReader(("first", "second"), leaves)
controls = np.zeros(7, np.float32)
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
    for name in ("look_around", "observe_racing", "write_racing_view"):
        assert check_lists_are_refused(getattr(kernel, name), cases[name][0][0])
