"""Rates the saved policies of runs in races against each other.

    python -m stkzoo.agents.training.rate runs/first runs/second --output ratings

It drives races of four policies and one kart of the game's AI at its highest difficulty, on
training tracks or those of ``--track``, with policies and grid positions drawn uniformly. Each race
is a line of ``matches.jsonl``. To continue, also after a kill, run the same command again, perhaps
with more ``--matches``. From all finishing orders it computes ratings with intervals
(``ratings.json``) and a plot of them over kart-steps (``ratings.png``). If the policies of the
first run choose plans, ``start`` is these plans without learning.
"""

from __future__ import annotations

import itertools
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stkzoo._arguments import option, positional
from stkzoo._checks import check_whole
from stkzoo._locks import locked_folder
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.errors import ConfigError
from stkzoo.evaluation import Rating, save_figure

from .common.arguments import QUICK_TRACKS, track_names
from .common.command import limit_threads, run_command
from .common.matches import (
    AI,
    SEATS,
    Match,
    MatchDriver,
    MatchRecord,
    match_driver,
    plan_match_driver,
    play_records,
    rate_orders,
)
from .common.run_folder import continue_json_lines, saved_policies, write_json
from .plot import rating_figure

#: Name of the plans without learning.
START = "start"
_RATINGS, _MATCHES, _PLOT = "ratings.json", "matches.jsonl", "ratings.png"
#: Number of races between two writes.
_AT_ONCE = 16


# ---------------------------------------------------------------------- policies of runs


def kept_policies(runs: Sequence[Path], every: int) -> dict[str, Path]:
    """Returns the saved policies of runs, named by run and millions of kart-steps.

    Args:
        runs: folders of the runs.
        every: minimum number of kart-steps between two policies; the first and last are kept.

    Raises:
        ConfigError: a folder has no policy, or two runs have the same name.
    """
    names = [run.name for run in runs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ConfigError(f"two runs are called {twice[0]!r}; give the runs other names")
    kept: list[Path] = []
    for run in runs:
        files = saved_policies(run)
        if not files:
            raise ConfigError(f"{str(run)!r} has no policy-*.safetensors; is it a run's folder?")
        last = -every
        for file in files:
            if _steps_of(file) - last >= every or file == files[-1]:
                kept.append(file)
                last = _steps_of(file)
    rounded = {(file.parent, f"{_steps_of(file) / 1e6:.2f}") for file in kept}
    digits = 2 if len(rounded) == len(kept) else 6
    return {f"{file.parent.name} {_steps_of(file) / 1e6:.{digits}f}": file for file in kept}


def run_drivers(files: Mapping[str, Path]) -> dict[str, MatchDriver]:
    """Returns the drivers of saved policies by name, and perhaps ``start``.

    Args:
        files: policy files by name, those of the first run first.

    Raises:
        ConfigError: a file is not a policy.
    """
    drivers = {name: match_driver(file) for name, file in files.items()}
    rules = next(iter(drivers.values())).rules
    if rules is None:
        return drivers
    return drivers | {START: plan_match_driver(RacingPolicy.of_plans_alone(), rules)}


def _steps_of(policy: Path) -> int:
    """Returns the kart-steps in the name of a saved policy."""
    return int(re.findall(r"\d+", policy.stem)[-1])


# ---------------------------------------------------------------------- all against all


def draw_match(names: Sequence[str], number: int, tracks: Sequence[str] = QUICK_TRACKS) -> Match:
    """Draws the match with a number; the same arguments give the same match.

    Names are shuffled, dealt and shuffled again, so that all occur equally often.
    """
    seats = [number * SEATS + seat for seat in range(SEATS)]
    rounds = {seat // len(names) for seat in seats}
    order = {turn: np.random.default_rng([turn, len(names)]).permutation(names) for turn in rounds}
    chosen = [str(order[seat // len(names)][seat % len(names)]) for seat in seats]
    places = list(itertools.product(tracks, (False, True)))
    lap, at = divmod(number, len(places))
    track, reverse = places[int(np.random.default_rng([lap, 1]).permutation(len(places))[at])]
    return Match(tuple(chosen), track, reverse, 3000 + lap)


def _rate_runs(
    runs: Sequence[Path], folder: Path, wanted: int, every: int, tracks: Sequence[str]
) -> None:
    kept = kept_policies(runs, every)
    drivers = run_drivers(kept)
    names = sorted(drivers)
    if len(names) < SEATS:
        raise ConfigError(f"there are {len(names)} policies, expected {SEATS} or more; see --every")
    records = _earlier_matches(folder / _MATCHES, names, tracks)
    while len(records) < wanted:
        numbers = range(len(records), min(wanted, len(records) + _AT_ONCE))
        played = play_records([draw_match(names, number, tracks) for number in numbers], drivers)
        with (folder / _MATCHES).open("a") as out:
            out.writelines(json.dumps(asdict(record)) + "\n" for record in played)
        records += played
        print(f"{len(records)} of {wanted} races", flush=True)
    ratings = rate_orders([record.order for record in records])
    rows = [
        {"name": name, **asdict(rating), "matches": sum(name in r.order for r in records)}
        for name, rating in sorted(ratings.items())
    ]
    write_json(folder / _RATINGS, {"matches": len(records), "ratings": rows})
    _draw(kept, ratings, folder / _PLOT, f"Saved policies in {len(records)} races")
    for name, rating in sorted(ratings.items(), key=lambda item: -item[1].value):
        print(f"{rating.value:6.2f} ({rating.low:.2f}..{rating.high:.2f})  {name}")


def _earlier_matches(file: Path, names: Sequence[str], tracks: Sequence[str]) -> list[MatchRecord]:
    """Returns the matches of an interrupted or shorter run of the command.

    Raises:
        ConfigError: they have other policies or other tracks.
    """
    records = continue_json_lines(file, MatchRecord)
    for number, record in enumerate(records):
        track = draw_match(names, number, tracks).track
        unknown = {*record.order} - {*names, AI}
        if unknown or record.track != track:
            raise ConfigError(
                f"{file} has match {number} of {', '.join(record.order)[:60]!r} on "
                f"{record.track!r}, expected policies of these runs on {track!r}; give the same "
                "runs and --track, or another --output"
            )
    return records


def _draw(kept: Mapping[str, Path], ratings: Mapping[str, Rating], file: Path, title: str) -> None:
    """Draws the ratings of each run's policies over kart-steps."""
    curves: dict[str, list[tuple[float, list[float]]]] = {}
    for name, policy in kept.items():
        curve = curves.setdefault(policy.parent.name, [])
        if START in ratings and not curve:
            curve.append((0.0, _ends(ratings[START])))
        if name in ratings:
            curve.append((_steps_of(policy) / 1e6, _ends(ratings[name])))
    levels = {"the AI": ratings[AI].value} if AI in ratings else {}
    save_figure(rating_figure(curves, levels, title), file)


def _ends(rating: Rating) -> list[float]:
    return [rating.value, *rating.interval]


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class RatingOptions:
    """Options of the command.

    Attributes:
        runs: folders of runs of any script.
        output: folder for races and ratings.
        matches: total races.
        every: minimum kart-steps between two policies; the first and last are always rated.
        tracks: names of tracks or of splits.

    Raises:
        ConfigError: a number is out of bounds.
    """

    runs: tuple[Path, ...] = positional()
    output: Path = option(required=True, metavar="FOLDER")
    matches: int = 200
    every: int = 1_000_000
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")

    def __post_init__(self) -> None:
        check_whole("every", self.every, 0)
        check_whole("matches", self.matches, 1)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds, remedy = (RatingOptions,), "the same command continues"
    return run_command("rate", __doc__, _run, kinds, words, remedy)


def _run(options: RatingOptions) -> None:
    limit_threads()
    with locked_folder(options.output, "rating"):
        tracks = track_names(options.tracks)
        _rate_runs(options.runs, options.output, options.matches, options.every, tracks)


if __name__ == "__main__":
    sys.exit(main())
