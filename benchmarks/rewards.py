"""Records the rewards of six different drivers on each track and in each direction.

Three karts do nothing useful: one stands still, one presses rescue, and one reverses. The game's AI
at difficulty 0, the pursuit driver and the heuristic driver race. The record contains the distance
and the position of each kart once per second. From these, ``tests/mdp/test_reward_order.py``
recomputes rewards::

    python -m benchmarks.rewards            # print the table from the record
    python -m benchmarks.rewards --record   # drive all races again (about three minutes)
    python -m benchmarks.rewards --track lighthouse   # drive one race and compare all built-in
        rewards
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import atomic_write
from stkzoo.config import AgentSpec
from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.mdp.rewards import REWARDS
from stkzoo.mdp.spaces import kart_action_space
from stkzoo.mdp.transition import Transition
from stkzoo.tracks import SPLITS

FloatArray = npt.NDArray[np.float64]

RECORD = Path(__file__).parent / "results" / "rewards.npz"
#: Karts of each race, in grid order.
KARTS = ("stands", "rescues", "reverses", "AI 0", "pursuit", "heuristic")
IDLERS = 3
#: Fields of a kart that the built-in rewards read.
FIELDS = ("overall_distance", "position", "has_finished_race", "finish_time")
ACTIONS = (
    {"acceleration": 0.0},
    {"acceleration": 0.0, "rescue": 1},
    {"acceleration": 0.0, "brake": 1},
)
MAX_STEPS, EVERY = 3000, 10


@dataclass(frozen=True)
class RecordedRace:
    """A recorded race.

    Attributes:
        track: name of the track.
        reverse: whether it was driven in reverse.
        length: length of the race [m].
        karts: ``(T, 6)`` structured array with :data:`FIELDS`; the first row is the grid.
        steps: ``(T,)`` step of each row.
    """

    track: str
    reverse: bool
    length: float
    karts: npt.NDArray[np.void]
    steps: npt.NDArray[np.int64]

    def returns(self, name: str) -> FloatArray:
        """Returns the return of each kart over the race, ``(6,)``, for a built-in reward.

        The sums of potentials and of rewards at the finish do not depend on the sampling interval.
        The rank term of the reference's formula does: it needs a recording of every step.
        """
        totals = np.zeros(len(KARTS))
        moments = [self._moment(row) for row in self.karts]
        for row, (before, after) in enumerate(pairwise(moments)):
            count = self.steps[row + 1]
            terms = REWARDS[name](Transition(before, after, self.length))
            if "time" in terms:  # earned in every step
                terms["time"] = terms["time"] * (count - self.steps[row])
            is_racing = before.karts["has_finished_race"] == 0
            totals += np.where(is_racing, sum(terms.values()), 0.0)
        return totals

    def finishers(self) -> list[int]:
        """Returns the karts that finished, the winner first."""
        times = self.karts["finish_time"].max(axis=0)
        return [int(kart) for kart in np.argsort(times) if times[kart] > 0]

    @staticmethod
    def _moment(row: npt.NDArray[np.void]) -> Snapshot:
        header = np.zeros(1, HEADER_DTYPE)
        header["num_kart"] = len(row)
        karts = np.zeros(len(row), KART_DTYPE)
        for name in FIELDS:
            karts[name] = row[name]
        return Snapshot.of(header[0], karts, np.zeros(0, ITEM_DTYPE))


def drive(track: str, reverse: bool, seed: int = 1, every: int = EVERY) -> RecordedRace:
    """Runs a race until its drivers have finished, and records every ``every`` steps."""
    with race_v0.parallel_env(
        agents=[AgentSpec(rank_start=kart) for kart in range(IDLERS)],
        num_kart=len(KARTS),
        opponents=["ai:0", "pursuit", "heuristic"],
        track=track,
        reverse=reverse,
        max_cycles=None,
    ) as env:
        env.reset(seed=seed)
        actions = {
            agent: _action(wanted) for agent, wanted in zip(env.agents, ACTIONS, strict=True)
        }
        steps, rows = [0], [env.snapshot.karts[list(FIELDS)].copy()]
        for step in range(1, MAX_STEPS + 1):
            env.step(actions)
            karts = env.snapshot.karts
            is_over = bool((karts["has_finished_race"][IDLERS:] > 0).all())
            has_new = (karts["has_finished_race"] > rows[-1]["has_finished_race"]).any()
            if step % every == 0 or has_new or is_over:
                rows.append(karts[list(FIELDS)].copy())
                steps.append(step)
            if is_over:
                break
        return RecordedRace(track, reverse, env.track_map.length, np.stack(rows), np.array(steps))


def _action(wanted: Mapping[str, float]) -> dict[str, Any]:
    """Returns an action in which all other entries are 0."""
    action = {key: np.zeros_like(value) for key, value in kart_action_space().sample().items()}
    for key, value in wanted.items():
        action[key] = np.full_like(action[key], value)
    return action


def record() -> None:
    """Drives all races and writes the record."""
    arrays: dict[str, npt.NDArray[np.void]] = {}
    for track in SPLITS["all"]:
        for reverse in (False, True):
            race = drive(track, reverse)
            name = f"{track}{'-reverse' if reverse else ''}"
            for field in FIELDS:
                arrays[f"{name}/{field}"] = race.karts[field]
            arrays[f"{name}/steps"] = race.steps
            arrays[f"{name}/length"] = np.array(race.length)
            print(f"{name}: {len(race.karts)} moments", flush=True)
    with atomic_write(RECORD) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def recorded() -> Iterator[RecordedRace]:
    """Yields the races of the record."""
    with np.load(RECORD) as arrays:
        for name in [key.removesuffix("/length") for key in arrays if key.endswith("/length")]:
            fields = [arrays[f"{name}/{field}"] for field in FIELDS]
            karts = np.zeros(
                fields[0].shape, [(f, v.dtype) for f, v in zip(FIELDS, fields, strict=True)]
            )
            for field, values in zip(FIELDS, fields, strict=True):
                karts[field] = values
            track, _, direction = name.partition("-")
            yield RecordedRace(
                track,
                bool(direction),
                float(arrays[f"{name}/length"]),
                karts,
                arrays[f"{name}/steps"],
            )


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.rewards", description=__doc__)
    parser.add_argument("--record", action="store_true", help="drive all the races again")
    parser.add_argument("--track", help="drive one race and compare the built-in rewards")
    arguments = parser.parse_args()
    if arguments.record:
        record()
    print(f"{'race':32}" + "".join(f"{name:>11}" for name in KARTS))
    if arguments.track:
        race = drive(arguments.track, reverse=False, every=1)
        for name in REWARDS:
            print(f"{name:32}" + "".join(f"{value:11.1f}" for value in race.returns(name)))
        return
    for race in recorded():
        name = f"{race.track}{' reverse' if race.reverse else ''}"
        print(f"{name:32}" + "".join(f"{value:11.1f}" for value in race.returns("race")))


if __name__ == "__main__":
    main()
