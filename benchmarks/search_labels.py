"""Measures whether the planner's decisions repeat with other random candidates.

A network can imitate the planner only as far as the state of a race determines its decision. One
kart races alone, driven by the planner. At each decision, the planner searches twice with
different candidates and follows the first result. The two results agree in direction if both steer
further than the base policy to the same side, or neither steers further. They agree fully if they
also have the same maneuver. For comparison, the command prints how often the results of different
decisions agree.

    python -m benchmarks.search_labels          # writes results/search_labels.json
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo import RaceParallelEnv, race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.agents.planner import Candidate, Planner
from stkzoo.tracks import SPLITS

OUTPUT = Path(__file__).parent / "results" / "search_labels.json"
TRACKS = ("lighthouse", "hacienda", "snowmountain", "minigolf")
DIFFICULTY = 3
#: Direction of the steering change, and maneuver.
Label = tuple[int, int | None]


class TwiceSearching(Planner):
    """A planner that searches twice for each decision and follows the first result."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed=seed)
        self.labels: list[tuple[Label, Label]] = []

    def _best_candidate(
        self, env: RaceParallelEnv, agent: str, observation: Mapping[str, Any]
    ) -> Candidate:
        first = super()._best_candidate(env, agent, observation)
        second = super()._best_candidate(env, agent, observation)
        self.labels.append((label(first), label(second)))
        return first


def label(candidate: Candidate) -> Label:
    """Returns what a network would learn from a decision."""
    if not candidate.steps:
        return 0, None
    return int(np.sign(candidate.shift)), candidate.maneuver


def race(track: str, seed: int) -> list[tuple[Label, Label]]:
    """Drives a race to the finish; returns the two labels of each decision."""
    env = race_v0.parallel_env(agents=1, num_kart=1, track=track, difficulty=DIFFICULTY)
    with closing(env), closing(TwiceSearching(seed)) as planner:
        observations, _ = env.reset(seed=seed)
        while env.agents:
            observations, *_ = env.step({"kart_0": planner.act(env, observations["kart_0"])})
        return planner.labels


def figures(labels: Sequence[tuple[Label, Label]]) -> dict[str, float]:
    """Returns how often labels repeat, and how often they would repeat by chance."""
    directions = [(first[0], second[0]) for first, second in labels]
    return {
        "decisions": len(labels),
        "direction": _agreement(directions),
        "direction_by_chance": _chance(directions),
        "label": _agreement(labels),
        "label_by_chance": _chance(labels),
    }


def _agreement(pairs: Sequence[tuple[Any, Any]]) -> float:
    return round(float(np.mean([first == second for first, second in pairs])), 3)


def _chance(pairs: Sequence[tuple[Any, Any]]) -> float:
    firsts, seconds = (Counter(column) for column in zip(*pairs, strict=True))
    return round(sum(firsts[own] * seconds[own] for own in firsts) / len(pairs) ** 2, 3)


def main() -> None:
    """Runs the command."""
    parser = CommandParser(prog="python -m benchmarks.search_labels", description=__doc__)
    parser.add_argument(
        "--track", nargs="+", choices=SPLITS["train"], default=TRACKS, metavar="NAME"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the races")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="JSON file")
    options = parser.parse_args()
    by_track = {track: race(track, options.seed) for track in options.track}
    everything = [pair for labels in by_track.values() for pair in labels]
    tracks = {track: figures(labels) for track, labels in by_track.items()}
    result = {"seed": options.seed, "tracks": tracks, "all": figures(everything)}
    write_text(options.output, json.dumps(result, indent=1) + "\n")
    for name, own in (*tracks.items(), ("all", result["all"])):
        print(name, own)


if __name__ == "__main__":
    main()
