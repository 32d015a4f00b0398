"""Tampers with an entry of `stkzoo suite` at random, and counts the refusals of `verify`.

    python -m benchmarks.tampering                  # 1,000 tampered entries, about an hour
    python -m benchmarks.tampering --entries 20

Each time, one thing is changed in a copy of an honest entry of six races: an action, a position,
a time, a seed, a condition, the order or the length of replays, or a number or rule of its card
(entry.json). For half of the changed replays, the card is updated with the new SHA-256. Statements
of the card about authors, software and failures of the agent cannot be verified and are not
changed.

Some actions have no effect, such as nitro with an empty tank. If such an action and its SHA-256
change, the replay is another recording of the same race, and nothing in the entry is false. Such an
entry is accepted and not counted; the benchmark draws another one.
"""

from __future__ import annotations

import itertools
import json
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, Table, host_facts, print_tables, progress_bar
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.errors import StkzooError
from stkzoo.suite import evaluate, verify_entry
from tests.support.entries import (
    SMALL,
    add_small_task,
    change_controls,
    change_header,
    change_replay,
    name_replays,
    read_entry,
    replay_of,
    write_entry,
)

#: Entries of the card that nothing can verify (``docs/reference/suite.md``).
UNVERIFIED = re.compile(
    r"\.(about|versions|agent|errors|sandboxes|protections|type|schema_version)(\.|\[|$)"
    r"|^\.(agent|interval)|\.settings\.(?!track|laps|difficulty|reverse|mode|kart|seed|max_paths|"
    r"max_steps|max_steps_after_first|karts_finished)"
)


def _leaves(value: Any, place: str = "") -> Iterator[tuple[Any, Any, str]]:
    """Yields the container, key and path of each number, text and boolean in a JSON value."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in pairs:
        where = f"{place}.{key}" if isinstance(value, dict) else f"{place}[{key}]"
        if isinstance(inner, (dict, list)):
            yield from _leaves(inner, where)
        else:
            yield value, key, where


def _other(value: Any, chance: random.Random) -> Any:
    """Returns another value of the same type."""
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int):
        return value + chance.choice((-1, 1, 2))
    if isinstance(value, float):
        return value * chance.choice((0.9, 0.99, 0.999, 1.01)) if value else 0.5
    return chance.choice(("hacienda", "reversed", "front", "PBB", value + "x", ""))


def change_card(folder: Path, chance: random.Random) -> str:
    """Changes one value of the card."""
    card = read_entry(folder)
    known = [leaf for leaf in _leaves(card) if not UNVERIFIED.search(leaf[2])]
    holder, key, place = chance.choice(known)
    holder[key] = _other(holder[key], chance)
    write_entry(folder, card)
    return place


def change_action(folder: Path, chance: random.Random) -> str:
    """Changes one control of one kart in some steps."""
    number, column = chance.randrange(_RACES), chance.randrange(7)
    first, kart, length = chance.random(), chance.random(), chance.choice((1, 1, 3, 20))

    def edit(controls: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        start, row = int(first * len(controls)), int(kart * controls.shape[1])
        part = controls[start : start + length, row, column]
        part[:] = 1 - part if column != 1 else np.where(part > 0, part - 0.5, part + 0.5)
        return controls

    change_controls(folder, number, edit)
    return f"race {number}, column {column}"


def change_length(folder: Path, chance: random.Random) -> str:
    """Truncates a race, or repeats its last step."""
    number, share = chance.randrange(_RACES), chance.random()
    is_longer = chance.random() < 0.3

    def cut(controls: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return controls[: max(int(share * len(controls)), 1)]

    def repeat(members: dict[str, bytes]) -> None:
        header = json.loads(members["race.json"])
        header["steps"] += 1
        members["race.json"] = json.dumps(header).encode()
        members["controls.f4"] += members["controls.f4"][-28 * len(header["agents"]) :]
        members["digests.u1"] += members["digests.u1"][-8:]

    if is_longer:
        change_replay(folder, number, repeat)
    else:
        change_controls(folder, number, cut)
    return f"race {number}"


def change_position(folder: Path, chance: random.Random) -> str:
    """Changes the digest of the positions, rotations and velocities of one step."""
    number, share, bit = chance.randrange(_RACES), chance.random(), 1 << chance.randrange(8)

    def edit(members: dict[str, bytes]) -> None:
        digests = bytearray(members["digests.u1"])
        digests[int(share * len(digests))] ^= bit
        members["digests.u1"] = bytes(digests)

    change_replay(folder, number, edit)
    return f"race {number}"


def change_time(folder: Path, chance: random.Random) -> str:
    """Changes a finish time, rank or distance in the result of a replay."""
    number, name = chance.randrange(_RACES), chance.choice(("finish_time", "rank", "distance"))

    def edit(header: dict[str, Any]) -> None:
        row = chance.choice(header["result"]["agents"])
        row[name] = 1 if row[name] is None else row[name] + (1 if name == "rank" else -0.5)

    change_header(folder, number, edit)
    return f"race {number}, {name}"


def change_condition(folder: Path, chance: random.Random) -> str:
    """Changes a seed or another condition of a race."""
    number = chance.randrange(_RACES)
    names = ("seed", "engine_seed", "difficulty", "laps", "track", "reverse", "num_tracks", "mode")
    name = chance.choice(names)

    def edit(header: dict[str, Any]) -> None:
        others = {"track": "hacienda", "reverse": not header["reverse"], "mode": "time_trial"}
        header[name] = others[name] if name in others else header[name] + 1
        header["difficulty"] %= 4

    change_header(folder, number, edit)
    return f"race {number}, {name}"


def change_order(folder: Path, chance: random.Random) -> str:
    """Swaps two replays, or replaces one with another."""
    one, two = chance.sample(range(_RACES), 2)
    first, second = replay_of(folder, one), replay_of(folder, two)
    if chance.random() < 0.5:
        shutil.copy(first, second)
    else:
        data = first.read_bytes()
        shutil.copy(second, first)
        second.write_bytes(data)
    return f"races {one} and {two}"


_RACES = 6
#: A change that may leave the race unchanged.
WITHOUT_EFFECT = "change_action with SHA-256"
#: Changes and their relative frequencies.
CHANGES: dict[Callable[[Path, random.Random], str], int] = {
    change_card: 4,
    change_action: 3,
    change_length: 1,
    change_position: 2,
    change_time: 2,
    change_condition: 2,
    change_order: 1,
}


def tamper(folder: Path, number: int, seed: int) -> str:
    """Makes the change that ``seed`` and ``number`` determine; returns its description."""
    chance = random.Random(f"{seed} {number}")
    (change,) = chance.choices([*CHANGES], [*CHANGES.values()])
    place = change(folder, chance)
    is_named = change is not change_card and chance.random() < 0.5
    if is_named:
        name_replays(folder)
    return f"{change.__name__}{' with SHA-256' if is_named else ''}: {place}"


def _refusal(folder: Path) -> str | None:
    """Returns why an entry is refused; ``None`` if it is accepted."""
    try:
        verify_entry(folder)
    except StkzooError as error:
        return str(error)
    return None


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.tampering", description=__doc__)
    words.add_argument("--entries", type=int, default=1000, metavar="N")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--output", type=Path, default=RESULTS / "tampering.json")
    options = words.parse_args(argv)
    add_small_task()
    refused: Counter[str] = Counter()
    accepted: list[str] = []
    located = same_race = 0
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as home, progress_bar(options.entries) as (bar, task):
        honest = Path(home, "honest")
        evaluate(SMALL, "heuristic@:Ada", output=honest, plot=False)
        verify_entry(honest)
        for number in itertools.count():
            folder = shutil.copytree(honest, Path(home, "entry"))
            what = tamper(folder, number, options.seed)
            error = _refusal(folder)
            shutil.rmtree(folder)
            if error is None and what.startswith(WITHOUT_EFFECT):
                same_race += 1
                continue
            if error is None:
                accepted.append(f"entry {number}, {what}")
                print(accepted[-1], file=sys.stderr, flush=True)
            else:
                refused[what.partition(":")[0]] += 1
                located += bool(re.search(r"race \d.*step \d", error))
            bar.advance(task)
            if sum(refused.values()) + len(accepted) == options.entries:
                break
    found = {
        "host": host_facts(),
        "seed": options.seed,
        "entries": options.entries,
        "refused": dict(sorted(refused.items())),
        "with_race_and_step": located,
        "same_race": same_race,
        "accepted": accepted,
        "seconds": round(time.monotonic() - begin, 1),
    }
    write_text(options.output, json.dumps(found, indent=1) + "\n")
    rows = [[name, str(count)] for name, count in sorted(refused.items())]
    print_tables([Table("tampered entries", ("change", "refused"), [*rows])])
    print(
        f"refused {sum(refused.values())} of {options.entries}, {located} with race and step; "
        f"accepted {len(accepted)}; {same_race} more were other recordings of the same race"
    )
    return 1 if accepted else 0


if __name__ == "__main__":
    sys.exit(main())
