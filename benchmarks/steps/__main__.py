"""Measures steps, resets, saved states and memory of the engine, stkzoo and pystk2-gymnasium.

    python -m benchmarks.steps                                        # all sections, 50 minutes
    python -m benchmarks.steps --section steps --karts 3 10 20 --steps 300
    python -m benchmarks.steps --section steps transport --view full flattened
    python -m benchmarks.steps --quick --output trial                 # figures mean nothing

Each section saves its results in a file of its own, and continues an interrupted run. An option
applies to the sections that have it; ``benchmarks/README.md`` describes them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.common import RESULTS, measure_all, parser, positive
from benchmarks.steps import memory, races, resets, vector
from benchmarks.steps.sections import VIEWS, Section
from stkzoo.tracks import SPLITS

SECTIONS: dict[str, Section] = {
    "steps": races.STEPS,
    "transport": races.TRANSPORT,
    "scaling": races.SCALING,
    "resets": resets.RESETS,
    "states": resets.STATES,
    "memory": memory.MEMORY,
    "vector": vector.VECTOR,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = _options().parse_args(arguments)
    is_same_race = True
    for name in words.section:
        section, options = SECTIONS[name], _options_of(words, name)
        print(f"== {name}: {section.help}", flush=True)
        results = measure_all(
            words.output / f"{name}.json",
            options,
            section.jobs(options),
            partial(section.measure, options=options),
            section.tables,
        )
        is_same_race &= all(result.get("same_race") is not False for result in results)
    if not is_same_race:
        print("contenders drove different races", file=sys.stderr)
    return int(not is_same_race)


def _options() -> argparse.ArgumentParser:
    words = parser("steps", __doc__)
    words.add_argument("--section", nargs="+", choices=SECTIONS, default=[*SECTIONS])
    words.add_argument("--steps", type=positive, metavar="N", help="measured steps or resets")
    words.add_argument("--karts", type=positive, nargs="+", metavar="K", help="numbers of karts")
    words.add_argument("--track", nargs="+", choices=SPLITS["all"], metavar="NAME")
    words.add_argument("--view", nargs="+", choices=VIEWS, metavar="VIEW")
    words.add_argument("--group", nargs="+", choices=races.GROUPS, help="of the section steps")
    words.add_argument("--races", type=positive, nargs="+", metavar="N", help="parallel races")
    words.add_argument("--rounds", type=positive, metavar="N", help="repetitions of each")
    words.add_argument("--cores", type=int, nargs="+", help="cores of a contender, 0 for all")
    words.add_argument("--quick", action="store_true", help="a trial run")
    words.add_argument("--output", type=Path, default=RESULTS, help="folder of the JSON files")
    return words


def _options_of(words: argparse.Namespace, name: str) -> argparse.Namespace:
    """Returns the options of a section: those given, and its defaults."""
    section = SECTIONS[name]
    values = {**section.defaults, **(section.quick if words.quick else {})}
    given = {option: getattr(words, option) for option in values}
    values |= {option: value for option, value in given.items() if value is not None}
    return argparse.Namespace(program="steps", section=name, **values)


if __name__ == "__main__":
    sys.exit(main())
