"""Observations are owned by the agents, although the kernel reuses memory that nobody holds."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest

from stkzoo import race_v0


@pytest.mark.parametrize(
    "keep",
    [
        lambda rows: rows,
        lambda rows: rows[-1],
        lambda rows: rows[0][1:],
        lambda rows: rows[0].base,
        lambda rows: memoryview(rows[1]),
    ],
    ids=["tuple", "row", "part of a row", "block", "memoryview"],
)
@pytest.mark.parametrize("key", ["paths_start", "paths_width", "items_position"])
def test_kept_observations_never_change(keep, key):
    with contextlib.closing(race_v0.parallel_env(num_kart=2, track="lighthouse")) as env:
        observations, _ = env.reset(seed=3)
        kept, copies = [], []
        for _ in range(12):
            kept.append(keep(observations["kart_0"][key]))
            copies.append(np.array(kept[-1]))
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            observations = env.step(actions)[0]
        for part, copy in zip(kept, copies, strict=True):
            np.testing.assert_array_equal(part, copy)
        assert not np.shares_memory(observations["kart_0"][key][0], observations["kart_1"][key][0])


def reshape(row):
    row.shape = (1, 3)


def make_read_only(row):
    row.flags.writeable = False


def swap_bytes(row):
    row.dtype = row.dtype.newbyteorder()


@pytest.mark.filterwarnings("ignore:Setting the:DeprecationWarning")  # since NumPy 2.5
@pytest.mark.parametrize("modify", [reshape, make_read_only, swap_bytes])
def test_modified_rows_are_not_reused(modify):
    with contextlib.closing(race_v0.parallel_env(num_kart=1, track="lighthouse")) as env:
        observations, _ = env.reset(seed=3)
        for _ in range(12):
            rows = observations["kart_0"]["paths_start"]
            assert {row.shape for row in rows} == {(3,)}
            assert all(row.flags.writeable and row.dtype.isnative for row in rows)
            modify(rows[0])
            del rows
            observations = env.step({"kart_0": env.action_space("kart_0").sample()})[0]
