"""Trains and rates a league of players that take turns to learn against past selves of all players.

    stkzoo league --output leagues/first --total-timesteps 2000000

This is AlphaStar's league (Vinyals et al., 2019), scaled down to one machine. In its turn, a player
trains with PPO (:mod:`stkzoo.agents.training.ppo.selfplay`) and saves a frozen copy, its newest
past self. A *main* player meets itself in half of its races and past selves of all players in the
others, most often those that it does not beat. An *exploiter* meets the main player's newest past
self, or older ones while the newest is too strong, to find its weaknesses. A *league exploiter*
meets all past selves. An exploiter that has won, or has run out of turns, starts over. After each
turn the new past self plays matches. Ratings come from the finishing orders of all matches, whose
members include the game's AI and the common starting policy.

To continue, also after a kill, run the same command again, perhaps with more ``--total-timesteps``;
an interrupted turn repeats bit for bit. The folder contains ``league.html`` (rating curves and
head-to-head results; open it in a browser), ``league.json``, ``members`` (weights that ``python -m
stkzoo.agents.training.export`` converts to agents) and a run folder per player.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from stkzoo._arguments import option
from stkzoo._locks import locked_folder
from stkzoo._os import using_folder, write_text
from stkzoo._schema import Count, Share
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError
from stkzoo.evaluation import require_jinja2, require_openskill

from ..common.arguments import BatchSize, Natural, PPOArguments, ScriptOptions, parse_races
from ..common.command import ProgressBar, run_command
from ..common.matches import MatchRecord, match_driver, play_records, rate_orders
from ..common.run_folder import LEAGUE, TrainingLog, check_resumed, read_run_file, write_json
from ..ppo.network import initial_weights
from ..ppo.run import PPORun
from ..ppo.selfplay import SelfPlayArguments, selfplay_setup
from .page import page
from .players import START, LeagueMember, Player, PlayerMatchmaker, draw_matches, new_players

_PAGE, _MEMBERS = "league.html", "members"
_VERSION = 3

#: Called after each iteration with the league's kart-steps, the player's name and its log line.
Report = Callable[[int, str, dict[str, float]], None]


@dataclass(frozen=True, slots=True)
class LeagueArguments(PPOArguments):
    """Arguments of a league; they must not change when a league continues.

    Attributes:
        mains: number of main players.
        exploiters: number of exploiters of the main players.
        league_exploiters: number of exploiters of the whole league.
        turn: kart-steps of a turn, without those of rivals.
        matches: matches of each new past self.
        patience: maximum turns of an exploiter before it starts over.
        tracks: tracks or splits for training and for matches, such as train_only.
        races: parallel races, as in ppo.selfplay; rivals drive in those without the game's AI.
        actors: number of processes that drive the races; 0 is one for each processor core.
            Results depend on their number.
        n_steps: steps of each race between two updates.
        anneal_timesteps: kart-steps of a player over which the learning rate decays.
        warm_up: iterations at the start that train only the value network.
        init: policy file that all players start from; empty starts from the plans.
    """

    hidden: tuple[int, int] = (256, 128)
    batch_size: BatchSize = 1024
    learning_rate: float = 1e-4
    gae_lambda: Share = 0.85
    mains: Annotated[int, Meta(ge=1, le=26)] = 1
    exploiters: Annotated[int, Meta(ge=0, le=26)] = 1
    league_exploiters: Annotated[int, Meta(ge=0, le=26)] = 1
    turn: int = 50_000
    matches: int = 8
    patience: int = 4
    tracks: tuple[str, ...] = option(
        ("lighthouse", "snowmountain", "hacienda", "cornfield_crossing"),
        flag="--track",
        metavar="TRACK",
    )
    races: tuple[str, ...] = ("4x6", "2+3x2")
    actors: Natural = 0
    n_steps: int = 128
    anneal_timesteps: int = 5_000_000
    warm_up: Natural = 5
    init: str = ""

    def __post_init__(self) -> None:
        PPOArguments.__post_init__(self)
        if not any(lineup.has_duels for lineup in parse_races(self.races)):
            raise ConfigError(
                f"races {' '.join(self.races)} leave no kart to rivals; add races of two or more "
                "agents without the game's AI, such as 4x6"
            )

    def of_learner(self, number: int, generation: int) -> SelfPlayArguments:
        """Returns the arguments of a player's run."""
        seeds = np.random.SeedSequence([self.seed, number, generation])
        shared = {entry.name for entry in fields(SelfPlayArguments)} - {"seed"}
        values = {name: value for name, value in asdict(self).items() if name in shared}
        return SelfPlayArguments(seed=int(seeds.generate_state(1)[0]), **values)


@dataclass(slots=True)
class _LeagueState:
    """State of a league between two turns, the content of ``league.json``."""

    arguments: dict[str, Any]
    players: Annotated[list[Player], Meta(min_length=1, max_length=100)]
    turn: Count = 0
    kart_steps: Count = 0
    members: list[LeagueMember] = field(default_factory=list)
    matches: list[MatchRecord] = field(default_factory=list)
    ratings: dict[str, list[float]] = field(default_factory=dict)


class League:
    """A league: its players, past selves and files.

    Args:
        folder: folder of the league.
        arguments: arguments of the league.

    Attributes:
        page: file of the page.

    Raises:
        ConfigError: a library is missing, an argument is invalid, or the folder cannot be created
            or contains another league.
    """

    def __init__(self, folder: str | Path, arguments: LeagueArguments) -> None:
        require_openskill()
        require_jinja2()
        self.folder, self.arguments = Path(folder), arguments
        self.page = self.folder / _PAGE
        self._members = self.folder / _MEMBERS
        with using_folder(self.folder, "league"):
            self._members.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(self.folder / LEAGUE):
            self._state = read_run_file(_LeagueState, self.folder / LEAGUE)
            check_resumed(self.folder, self._state.arguments, asdict(arguments))
            return
        players = new_players(arguments.mains, arguments.exploiters, arguments.league_exploiters)
        self._state = _LeagueState(asdict(arguments), players)
        save_weights(self._file(START), _start_weights(arguments))
        self._admit(START, "", 0)
        self._save()

    @property
    def kart_steps(self) -> int:
        """Kart-steps of all players."""
        return self._state.kart_steps

    def play_turn(self, report: Report) -> str:
        """Plays the next turn and writes its results.

        All random numbers derive from the league's seed and the turn's number.

        Args:
            report: called after each iteration.

        Returns:
            Name of the newest member.
        """
        state = self._state
        player = state.players[state.turn % len(state.players)]
        beaten = self._learn(player, report)
        state.turn += 1
        player.turns += 1
        name = f"{player.name}-{player.total_turns:03d}"
        self._admit(name, player.name, player.kart_steps)
        self._play_matches(name)
        if player.is_done(beaten, self.arguments.patience):
            player.start_over()
        self._save()
        return name

    def table(self) -> list[str]:
        """Returns the lines of a table of ratings, best first."""
        ranking = sorted(self._state.ratings.items(), key=lambda item: -item[1][0])
        return [f"{name:>24}  {r[0]:5.1f} ({r[1]:5.1f} to {r[2]:5.1f})" for name, r in ranking]

    # ------------------------------------------------------------------ parts of a turn

    def _learn(self, player: Player, report: Report) -> float:
        """Trains and saves checkpoint and weights, unless this was done already.

        Returns:
            The fraction of duels won in this turn.
        """
        state, arguments = self._state, self.arguments
        until = player.kart_steps + arguments.turn
        of_player = arguments.of_learner(state.players.index(player), player.generation)
        matchmaker = PlayerMatchmaker(player, state.members)
        setup = replace(selfplay_setup(of_player), matchmaker=matchmaker, past=self._members)
        if of_player.init:  # the file may be gone; the league has a copy
            setup = replace(setup, read_first=partial(load_weights, self._file(START)))
        with closing(PPORun(self.folder / player.folder, of_player, setup)) as run:
            if run.kart_steps < until:  # otherwise, interrupted after the checkpoint of this turn
                matchmaker.reported.clear()
                with TrainingLog(run.folder, run.iteration) as log:
                    while run.kart_steps < until:
                        line = run.iterate()
                        log.write(line)
                        done = state.kart_steps + run.kart_steps - player.kart_steps
                        report(done, player.name, line)
                run.save_checkpoint()
            state.kart_steps += run.kart_steps - player.kart_steps
            player.kart_steps = run.kart_steps
            run.save_policy(self._file(f"{player.name}-{player.total_turns + 1:03d}"))
        return matchmaker.beaten()

    def _file(self, name: str) -> Path:
        """Returns a member's file."""
        return self._members / f"{name}.safetensors"

    def _admit(self, name: str, player: str, kart_steps: int) -> None:
        state = self._state
        state.members.append(LeagueMember(name, player, state.turn, kart_steps, state.kart_steps))

    def _play_matches(self, name: str) -> None:
        """Plays the newest member's matches and rates all members."""
        state, arguments = self._state, self.arguments
        names = [member.name for member in state.members]
        random = np.random.default_rng([arguments.seed, state.turn, 1])
        matches = draw_matches(
            name, names, state.matches, arguments.tracks, arguments.matches, random
        )
        meeting = {member for match in matches for member in match.drivers}
        drivers = {member: match_driver(self._file(member)) for member in meeting}
        state.matches += play_records(matches, drivers, state.turn)
        ratings = rate_orders([match.order for match in state.matches])
        state.ratings = {name: [r.value, *r.interval] for name, r in ratings.items()}

    # ------------------------------------------------------------------ files

    def _save(self) -> None:
        state = self._state
        if state.ratings:
            write_text(self.page, page(state.members, state.matches, state.ratings))
        write_json(self.folder / LEAGUE, {"version": _VERSION, **asdict(state)})


def _start_weights(arguments: LeagueArguments) -> Mapping[str, Any]:
    """Returns the weights that all players start from."""
    if not arguments.init:
        return RacingPolicy.of_plans_alone().weights
    return initial_weights(arguments.init, arguments.hidden)


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class LeagueOptions(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps.
    """

    total_timesteps: int = 2_000_000


def play(options: LeagueOptions, arguments: LeagueArguments) -> None:
    """Starts or continues a league.

    Raises:
        ConfigError: see :class:`League`; or another program uses the folder.
    """
    total = options.total_timesteps
    with locked_folder(options.output, "league"):
        league = League(options.output, arguments)
        with ProgressBar(total, league.kart_steps) as bar:
            while league.kart_steps < total:
                begin, before = time.perf_counter(), league.kart_steps
                name = league.play_turn(partial(_show, bar))
                speed = (league.kart_steps - before) / (time.perf_counter() - begin)
                print(f"{league.kart_steps:>10,}  {name}  {speed:.0f} kart-steps/s", flush=True)
    print("\n".join(league.table()))
    print(league.page)


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds, remedy = (LeagueOptions, LeagueArguments), "the same command plays this turn again"
    return run_command("league", __doc__, play, kinds, words, remedy)


def _show(bar: ProgressBar, done: int, player: str, line: dict[str, float]) -> None:
    """Updates the progress bar after an iteration."""
    ratio = line.get("selfplay_ratio")
    shown = "" if ratio is None else f"  time ratio {ratio:.3f}"
    bar.show(done, f"{player}{shown}  {line['kart_steps_per_s']:.0f}/s")


if __name__ == "__main__":
    sys.exit(main())
