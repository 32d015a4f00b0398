"""A league: players learn in turns against each other's past selves, and are rated.

    stkzoo league --output leagues/first --until 2000000

AlphaStar's league (Vinyals et al., 2019) scaled down to one machine. In its turn a player learns
for a while with the fast learner (``ppo_selfplay``) and leaves a frozen copy, its newest past
self. A *main* player meets itself in half of its races and all past selves of everybody in the
others, those more often that it does not beat. An *exploiter* meets the main player's newest
past self (or older ones, while the newest is too strong) to find out how it can be beaten; a
*league exploiter* meets all past selves. When one of these two has won, or has tried for long,
it begins anew. After each turn the new past self drives matches; the ratings of all members come
of the orders of all matches, with the game's AI and what everybody started from among them.

The same command with a higher ``--until`` goes on, and so does the same command after the
program was killed: the turn that was under way is played again, exactly as it was. In the
folder: ``league.html`` (rating curves and who beats whom; open it in a browser), ``league.json``,
``members`` (weights, which ``export_policy`` makes agents of) and a run's folder for each player.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import atomic_write
from stkzoo.agents.pretrained.driver import check_shapes
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.ratings import require_openskill

from ..common.arguments import RunBar, add_arguments, changes, values_of
from ..common.training_log import Journal
from ..ppo.selfplay import Arguments as LearnerArguments
from .learner import LeagueLearner
from .matches import Match, draw_pairings, play, ratings_of
from .page import page
from .players import START, Player, PlayerMatchmaker, new_players

__all__ = ["Arguments", "League", "main"]

_STATE, _PAGE, _MEMBERS, _DUELS = "league.json", "league.html", "members", "duels.json"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Arguments:
    """What a league is made of; kept with it, and it goes on with the same only.

    Attributes:
        seed: of everything.
        mains: main players.
        exploiters: exploiters of the main players.
        league_exploiters: exploiters of the whole league.
        turn: kart-steps of a turn, those of rivals not counted.
        matches: of each new past self.
        patience: turns after which an exploiter begins anew, whatever it has won.
        tracks: for learning and for matches.
        forms: races side by side, as for ppo_selfplay; rivals drive where no AI does.
        groups: as for ppo_selfplay, like all that follow.
        steps: of every race between two updates.
        epochs: how often an update goes over what was seen.
        minibatch: kart-steps of a gradient.
        learning_rate: at the start.
        warm_up: iterations at the start in which only the value is learned.
        total: kart-steps of a player over which the learning rate goes down.
        hidden: units of the layers.
        init: all start from these weights; empty starts from the plans alone.
    """

    seed: int = 0
    mains: int = 1
    exploiters: int = 1
    league_exploiters: int = 1
    turn: int = 50_000
    matches: int = 8
    patience: int = 4
    tracks: tuple[str, ...] = ("lighthouse", "snowmountain", "hacienda", "cornfield_crossing")
    forms: tuple[str, ...] = ("4x6", "2+3x2")
    groups: int = 2
    steps: int = 128
    epochs: int = 4
    minibatch: int = 1024
    learning_rate: float = 1e-4
    warm_up: int = 5
    total: int = 5_000_000
    hidden: tuple[int, ...] = (256, 128)
    init: str = ""

    def of_learner(self, number: int, generation: int) -> LearnerArguments:
        """What the run of a player, by its number, is made of."""
        seeds = np.random.SeedSequence([self.seed, number, generation])
        shared = {entry.name for entry in fields(LearnerArguments)} - {"seed"}
        values = {name: value for name, value in asdict(self).items() if name in shared}
        return LearnerArguments(seed=int(seeds.generate_state(1)[0]), **values)


@dataclass(slots=True)
class _State:
    """A league between two turns."""

    turn: int = 0
    kart_steps: int = 0
    players: list[Player] = field(default_factory=list)
    members: list[dict[str, Any]] = field(default_factory=list)
    matches: list[Match] = field(default_factory=list)
    ratings: dict[str, list[float]] = field(default_factory=dict)


class League:
    """A league: its players, past selves and files.

    Args:
        folder: where it is kept.
        arguments: what it is made of.

    Raises:
        ConfigError: something is missing, cannot be, or is not what the folder's league is made of.
    """

    def __init__(self, folder: str | Path, arguments: Arguments) -> None:
        require_openskill()
        self.folder, self.arguments = Path(folder), arguments
        (self.folder / _MEMBERS).mkdir(parents=True, exist_ok=True)
        self._policies: dict[str, RacingPolicy] = {}
        self._state = _State()
        if (self.folder / _STATE).exists():
            self._restore()
            return
        counts = arguments.mains, arguments.exploiters, arguments.league_exploiters
        self._state.players = new_players(*counts)
        save_weights(self._file(START), _start_weights(arguments))
        self._admit(START, "", 0)
        self._save()

    @property
    def kart_steps(self) -> int:
        """How many there have been, of all players."""
        return self._state.kart_steps

    @property
    def page(self) -> Path:
        """The page's file."""
        return self.folder / _PAGE

    def play_turn(self, tell: Callable[[int, str, dict[str, float]], None]) -> str:
        """Plays the next turn, and writes what came of it.

        All chance comes from the league's seed and the turn's number.

        Args:
            tell: gets, after each iteration, the league's kart-steps, the player's name and its
                line of the log.

        Returns:
            The newest member's name.
        """
        state = self._state
        player = state.players[state.turn % len(state.players)]
        matchmaker = PlayerMatchmaker(player, state.members, self.policy)
        self._learn(player, matchmaker, tell)
        state.turn += 1
        player.turns += 1
        name = f"{player.name}-{player.total_turns:03d}"
        self._admit(name, player.name, player.kart_steps)
        self._match(name)
        if player.is_done(matchmaker.beaten(), self.arguments.patience):
            player.begin_anew()
        self._save()
        return name

    def policy(self, name: str) -> RacingPolicy:
        """A member's policy."""
        if name not in self._policies:
            self._policies[name] = RacingPolicy(load_weights(self._file(name)))
        return self._policies[name]

    def table(self) -> list[str]:
        """The ratings, for people, best first."""
        found = sorted(self._state.ratings.items(), key=lambda item: -item[1][0])
        return [f"{name:>24}  {r[0]:5.1f} ({r[1]:5.1f} to {r[2]:5.1f})" for name, r in found]

    # ------------------------------------------------------------------ parts of a turn

    def _learn(
        self,
        player: Player,
        matchmaker: PlayerMatchmaker,
        tell: Callable[[int, str, dict[str, float]], None],
    ) -> None:
        """Learns, and keeps checkpoint, duels and weights; nothing of it if it was done before."""
        state, folder = self._state, self.folder / player.folder
        until = player.kart_steps + self.arguments.turn
        arguments = self.arguments.of_learner(state.players.index(player), player.generation)
        learner = LeagueLearner(folder, arguments, matchmaker, [self.arguments.seed, state.turn])
        journal = Journal(folder, learner.iteration)
        try:
            is_played = learner.kart_steps >= until
            while learner.kart_steps < until:
                line = learner.iterate()
                journal.write(line)
                done = state.kart_steps + learner.kart_steps - player.kart_steps
                tell(done, player.name, line)
            if is_played:  # the program ended between the checkpoint and the league's state
                matchmaker.restore(json.loads((folder / _DUELS).read_text()))
            else:
                with atomic_write(folder / _DUELS) as part:
                    part.write_text(json.dumps(matchmaker.state()))
                learner.save_checkpoint()
            player.pool = matchmaker.pool.state()
            state.kart_steps += learner.kart_steps - player.kart_steps
            player.kart_steps = learner.kart_steps
            name = f"{player.name}-{player.total_turns + 1:03d}"
            save_weights(self._file(name), learner.weights())
        finally:
            journal.close()
            learner.close()

    def _admit(self, name: str, player: str, kart_steps: int) -> None:
        self._state.members.append(
            {
                "name": name,
                "player": player,
                "turn": self._state.turn,
                "kart_steps": kart_steps,
                "league_steps": self._state.kart_steps,
            }
        )

    def _match(self, name: str) -> None:
        """The newest member's matches, and everybody's ratings after them."""
        state, arguments = self._state, self.arguments
        names = [member["name"] for member in state.members]
        random = np.random.default_rng([arguments.seed, state.turn, 1])
        pairings = draw_pairings(
            name, names, state.matches, arguments.tracks, arguments.matches, random
        )
        policies = {member: self.policy(member) for p in pairings for member in p.members}
        state.matches += play(pairings, policies, state.turn)
        state.ratings = {
            member: [rating.value, rating.low, rating.high]
            for member, rating in ratings_of(state.matches).items()
        }

    # ------------------------------------------------------------------ keeping

    def _file(self, name: str) -> Path:
        return self.folder / _MEMBERS / f"{name}.safetensors"

    def _save(self) -> None:
        state = self._state
        if state.ratings:
            with atomic_write(self.folder / _PAGE) as part:
                part.write_text(page(state.members, state.matches, state.ratings))
        found = {
            "version": _VERSION,
            "arguments": asdict(self.arguments),
            "turn": state.turn,
            "kart_steps": state.kart_steps,
            "players": [asdict(player) for player in state.players],
            "members": state.members,
            "matches": [asdict(match) for match in state.matches],
            "ratings": state.ratings,
        }
        with atomic_write(self.folder / _STATE) as part:
            part.write_text(json.dumps(found, indent=1) + "\n")

    def _restore(self) -> None:
        found = json.loads((self.folder / _STATE).read_text())
        told = changes(found["arguments"], asdict(self.arguments))
        if told:
            raise ConfigError(
                f"the league in {str(self.folder)!r} has other arguments: {told}; give the same, "
                "or another --output"
            )
        self._state = _State(
            turn=found["turn"],
            kart_steps=found["kart_steps"],
            players=[Player(**player) for player in found["players"]],
            members=found["members"],
            matches=[Match(**match) for match in found["matches"]],
            ratings=found["ratings"],
        )


def _start_weights(arguments: Arguments) -> Mapping[str, Any]:
    """What everybody starts from: a file's weights, or the plans alone."""
    if not arguments.init:
        return RacingPolicy.of_plans_alone().weights
    weights = load_weights(arguments.init)
    check_shapes(weights, arguments.init)
    hidden = tuple(len(weights[name]) for name in ("b0", "b1"))
    if hidden != arguments.hidden:
        raise ConfigError(
            f"the weights {arguments.init!r} have layers of {hidden[0]} and {hidden[1]} units, "
            f"expected {arguments.hidden}; give --hidden {hidden[0]} {hidden[1]}"
        )
    return weights


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="stkzoo league",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", required=True, help="the league's folder")
    parser.add_argument("--until", type=int, default=2_000_000, help="kart-steps in all")
    add_arguments(parser, Arguments)
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = vars(_parser().parse_args(words))
    folder, until = options.pop("output"), options.pop("until")
    bar = None
    try:
        league = League(folder, Arguments(**values_of(options)))
        bar = RunBar(until, league.kart_steps)
        while league.kart_steps < until:
            begin, before = time.perf_counter(), league.kart_steps
            name = league.play_turn(functools.partial(_show, bar))
            speed = (league.kart_steps - before) / (time.perf_counter() - begin)
            print(f"{league.kart_steps:>10,}  {name}  {speed:.0f} kart-steps/s", flush=True)
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; the same command plays this turn again", file=sys.stderr)
        return 130
    finally:
        if bar is not None:
            bar.stop()
    print("\n".join(league.table()))
    print(league.page)
    return 0


def _show(bar: RunBar, done: int, player: str, line: dict[str, float]) -> None:
    """Moves the bar after an iteration of a turn."""
    ratio = line.get("selfplay_ratio")
    told = "" if ratio is None else f"  time ratio {ratio:.3f}"
    bar.show(done, f"{player}{told}  {line['kart_steps_per_s']:.0f}/s")


if __name__ == "__main__":
    sys.exit(main())
