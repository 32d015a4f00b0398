"""Runs of PPO: iterations, log, checkpoints, policies.

In a :class:`PPORun`, processes drive races and fill rollouts in shared memory (:mod:`.rollouts`).
They drive the next rollout during an update (:mod:`.update`), with the networks from before the
update.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from stkzoo._locks import locked_folder
from stkzoo._os import cpu_count
from stkzoo._schema import Count
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.weights import save_weights

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import LearnerArguments, RolloutArguments
from ..common.command import ProgressBar
from ..common.matches import UNFINISHED
from ..common.run_folder import (
    ARGUMENTS,
    TrainingLog,
    check_resumed,
    load_checkpoint,
    policy_name,
    reading_checkpoint,
    remove_later_policies,
    save_checkpoint,
    write_json,
)
from .network import ActorCritic
from .opponents import DuelResults, Matchmaker
from .rollouts import ActorArguments, ActorRaces, KartRace, RaceActor, RolloutResult, Weights, dealt
from .update import anneal, update

#: Number of finished races in the means of the log.
_RECENT = 200


@dataclass(frozen=True, slots=True)
class PPOSetup:
    """What a run learns, and against whom.

    Attributes:
        groups: its races.
        make_network: makes new networks.
        read_first: returns the policy to start from; ``None`` starts from new networks.
        plans: parameters of the plans among which the policy chooses; ``None`` without plans.
        bootstraps_finish: whether returns go on after the finish.
        hold: minimum steps of a drift without plans; ``None`` without an action filter.
        matchmaker: determines the opponents.
        tracks: determines the tracks; in it, the game's AI is an opponent on each track. Only SB3's
            races use it.
        past: folder of the past selves; ``None`` for the run's own folder.
    """

    groups: tuple[ActorRaces, ...]
    make_network: Callable[[], ActorCritic]
    read_first: Callable[[], Weights] | None = None
    plans: DriverParameters | None = None
    bootstraps_finish: bool = False
    hold: int | None = None
    matchmaker: Matchmaker = field(default_factory=Matchmaker)
    tracks: Matchmaker = field(default_factory=Matchmaker)
    past: Path | None = None


@dataclass(frozen=True, slots=True)
class PPOFacts:
    """The facts in the checkpoint of a run.

    Attributes:
        history: arguments of the run; older versions may have one entry for each part of it.
        kart_steps: number of kart-steps so far.
        iteration: number of iterations so far.
        recent: the latest races of learners.
        duels: results of the duels with past selves.
        tracks: results on each track.
    """

    history: Annotated[list[dict[str, Any]], Meta(min_length=1)]
    kart_steps: Count
    iteration: Count
    recent: tuple[KartRace, ...]
    duels: DuelResults
    tracks: DuelResults = field(default_factory=DuelResults)


class TrainingRun(ABC):
    """A run that learns in iterations: its networks, results and files.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        setup: what it learns.

    Attributes:
        folder: see the argument.
        arguments: see the argument.
        network: policy and value network.
        matchmaker: determines the opponents.
        kart_steps: number of kart-steps so far.
        iteration: number of iterations so far.
        recent: the latest races of learners.

    Raises:
        ConfigError: the folder cannot be created, another program uses it, or it contains a run
            with other arguments; or an argument is invalid.
    """

    def __init__(self, folder: str | Path, arguments: LearnerArguments, setup: PPOSetup) -> None:
        self.folder, self.arguments, self._setup = Path(folder), arguments, setup
        self.matchmaker = setup.matchmaker
        with ExitStack() as resources:
            resources.enter_context(locked_folder(self.folder, "run"))
            checkpoint = load_checkpoint(self.folder, PPOFacts)
            self.network = setup.make_network()
            self.kart_steps = self.iteration = 0
            self.recent: deque[KartRace] = deque(maxlen=_RECENT)
            plans = {} if setup.plans is None else {"rules": asdict(setup.plans)}
            self._history: list[dict[str, Any]] = [
                {"from": 0, "arguments": asdict(arguments), **plans}
            ]
            if checkpoint:
                self._restore(*checkpoint)
            elif setup.read_first is not None:
                self.network.start_from(setup.read_first())
            write_json(self.folder / ARGUMENTS, self._history)
            resources.callback(self._make_races())
            self.begin_races()
            self._resources = resources.pop_all()

    @abstractmethod
    def begin_races(self) -> None:
        """Starts new races; later random numbers derive from seed and iteration."""

    @abstractmethod
    def iterate(self) -> dict[str, float]:
        """Updates the networks with a rollout; returns the log entry."""

    def is_checkpoint(self, iteration: int) -> bool:
        """Returns whether a checkpoint follows an iteration; all races restart after it."""
        return iteration % self.arguments.checkpoint_every == 0

    def learn(self, total: int, shown: Sequence[str]) -> Path:
        """Learns until a number of kart-steps, with a progress bar, a log and all files.

        Args:
            total: the number of kart-steps.
            shown: figures of the log to show.

        Returns:
            The file of the last policy.
        """
        keep_every = self.arguments.keep_every
        with (
            TrainingLog(self.folder, self.iteration) as log,
            ProgressBar(total, self.kart_steps) as bar,
        ):
            while self.kart_steps < total:
                before = self.kart_steps
                line = self.iterate()
                log.write(line)
                figures = [f"{name} {line[name]:.3f}" for name in shown if name in line]
                bar.report(
                    self.kart_steps, f"{'  '.join(figures)}  {line['kart_steps_per_s']:.0f}/s"
                )
                if self.kart_steps // keep_every > before // keep_every:
                    self.save_policy()
                if self.is_checkpoint(self.iteration):
                    self.save_checkpoint()
                    self.begin_races()
            self.save_checkpoint()
            return self.save_policy()

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``; call :meth:`begin_races` next, as a resumed run does."""
        facts = {
            "history": self._history,
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "recent": [asdict(finish) for finish in self.recent],
            "duels": self.matchmaker.state(),
            "tracks": self._setup.tracks.state(),
        }
        save_checkpoint(self.folder, facts, {"network": self.network.state()})

    def save_policy(self, path: Path | None = None) -> Path:
        """Writes the current policy, by default as a past self to the run's folder.

        Returns:
            The file.
        """
        if path is None:
            path = self.folder / f"{policy_name(self.kart_steps)}.safetensors"
            self.matchmaker.add(path.stem)
        save_weights(path, self.network.policy_weights())
        return path

    def close(self) -> None:
        """Ends all races, and unlocks the folder."""
        self._resources.close()

    @abstractmethod
    def _make_races(self) -> Callable[[], None]:
        """Makes what drives the races; returns the function that ends it."""

    def _restore(self, facts: PPOFacts, state: Mapping[str, Any]) -> None:
        before, now = (
            {**part["arguments"], **part.get("rules", {})}
            for part in (facts.history[-1], self._history[-1])
        )
        check_resumed(self.folder, before, now)
        self.kart_steps, self.iteration = facts.kart_steps, facts.iteration
        remove_later_policies(self.folder, self.kart_steps)
        self.recent.extend(facts.recent)
        self.matchmaker.restore(facts.duels)
        self._setup.tracks.restore(facts.tracks)
        with reading_checkpoint(self.folder):
            self.network.restore(state["network"])


class PPORun(TrainingRun):
    """A run whose actors keep driving while it learns."""

    arguments: RolloutArguments

    def begin_races(self) -> None:
        """See :class:`TrainingRun`."""
        seed = self.arguments.seed
        self._random = np.random.default_rng([seed, self.iteration])
        if self._actors.is_busy:
            self._actors.receive()  # a rollout of the races before
        seeds = [([seed, self.iteration, number],) for number in range(len(self._actors))]
        self._actors.call("begin", seeds)

    def iterate(self) -> dict[str, float]:
        """See :class:`TrainingRun`."""
        begin = time.perf_counter()
        if not self._actors.is_busy:
            self._drive(self.iteration)
        driven: list[RolloutResult] = self._actors.receive()
        rollouts = [memory[self.iteration % 2] for memory in self._rollouts]
        is_changed = self.iteration == 0 and self.network.prepare(
            np.concatenate([rollout[rollout["active"]] for rollout in rollouts])
        )
        for duel in (duel for result in driven for duel in result.duels):
            self.matchmaker.update(*duel)
        if not (is_changed or self.is_checkpoint(self.iteration + 1) or self.arguments.on_policy):
            self._drive(self.iteration + 1)
        waited = time.perf_counter()
        ent_coef = anneal(self.network, self.arguments, self.kart_steps, self.iteration)
        last_values = [result.last_values for result in driven]
        learned = update(
            self.network, rollouts, last_values, self.arguments, ent_coef, self._random
        )
        for result in driven:
            self.recent.extend(result.finishes)
        self.iteration += 1
        steps = sum(result.kart_steps for result in driven)
        self.kart_steps += steps
        end = time.perf_counter()
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            **race_figures(self.recent),
            **self.matchmaker.figures(),
            **learned,
            "wait_s": waited - begin,
            "learn_s": end - waited,
            "kart_steps_per_s": steps / (end - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def _make_races(self) -> Callable[[], None]:
        arguments, setup = self.arguments, self._setup
        races = sum(group.num_races for group in setup.groups)
        shares = [
            ActorArguments(
                groups=groups,
                shape=self.network.shape,
                plans=setup.plans,
                past=setup.past or self.folder,
                bootstraps_finish=setup.bootstraps_finish,
                hold=setup.hold,
            )
            for groups in dealt(setup.groups, min(arguments.actors or cpu_count(), races))
        ]
        row_type = self.network.shape.rollout_type()
        memories = [
            SharedArray((2, arguments.n_steps, share.num_slots), row_type) for share in shares
        ]
        self._actors = self._new_actors(list(zip(shares, memories, strict=True)))
        self._rollouts = [memory.array() for memory in memories]
        return self._actors.close

    def _new_actors(self, arguments: Sequence[tuple[ActorArguments, SharedArray]]) -> ActorPool:
        return ActorPool(RaceActor, arguments)

    def _drive(self, iteration: int) -> None:
        """Lets the actors drive the rollout of an iteration with the current networks."""
        call = (iteration % 2, *self.network.weights(), self.matchmaker.odds())
        self._actors.send("drive", [call] * len(self._actors))


def race_figures(recent: Sequence[KartRace] | deque[KartRace]) -> dict[str, float]:
    """Returns figures about the latest races of learners for the log."""
    if not recent:
        return {}
    means: dict[str, list[Any]] = {
        "return": [race.reward for race in recent],
        "finished": [race.ratio is not None for race in recent],
        "position": [race.position for race in recent],
        "won": [race.ratio is not None and race.position == 1 for race in recent],
    }
    for company in ("alone", "selfplay", "rivals"):
        races = [race for race in recent if race.company == company]
        if races:
            finished = [race.ratio for race in races if race.ratio is not None]
            means[f"{company}_ratio"] = [race.ratio or UNFINISHED for race in races]
            means[f"{company}_finished_ratio"] = finished or [0.0]
            means[f"{company}_unfinished"] = [race.ratio is None for race in races]
            if company == "rivals":
                means["rivals_rank"] = [race.position for race in races]
                means["rivals_first"] = [race.position == 1 for race in races]
    return {name: float(np.mean(values)) for name, values in means.items()}
