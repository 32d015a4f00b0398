"""A run that learns while its actors keep driving: iterations, log, checkpoints and policies.

Processes drive races and fill rollouts in shared memory (:mod:`.actors`). They drive the next
rollout during an update, with the networks from before the update.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from stkzoo._locks import locked_folder
from stkzoo._schema import Count
from stkzoo.agents.pretrained.weights import save_weights

from .actors import ActorPool
from .arguments import OverlappedArguments
from .command import ProgressBar
from .run_folder import (
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

FloatArray = npt.NDArray[np.float32]
Weights = Mapping[str, FloatArray]

#: Number of finished races in the means of the log.
_RECENT = 200


@dataclass(frozen=True, slots=True)
class RolloutResult:
    """Results of an actor's rollout that are not in its array.

    Attributes:
        last_values: ``(S,)`` values of the inputs after its last step.
        finishes: the races of learners that ended.
        duels: name of the rival and fraction of the duels that the learners won, for each race with
            a rival that ended.
    """

    last_values: FloatArray
    finishes: list[Any]
    duels: list[tuple[str, float]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class RunFacts:
    """The facts in the checkpoint of a run. Runs add ``recent``, their latest finishes.

    Attributes:
        history: arguments of each part of the run, with the kart-steps at which it began.
        kart_steps: number of kart-steps so far.
        iteration: number of iterations so far.
    """

    history: Annotated[list[dict[str, Any]], Meta(min_length=1)]
    kart_steps: Count
    iteration: Count


class LearningNetwork(ABC):
    """The networks of a run, with their optimizer.

    Attributes:
        torch: the module ``torch``.
    """

    torch: Any

    def prepare(self, seen: npt.NDArray[np.void]) -> bool:  # noqa: ARG002 - for subclasses
        """Adapts the networks to the rows of the first rollout, such as the scale of the inputs.

        Returns:
            Whether the networks changed; by default, they do not.
        """
        return False

    @abstractmethod
    def weights(self) -> tuple[Weights, Weights]:
        """Returns the weights of policy and value network for the actors; files have the first."""

    @abstractmethod
    def state(self) -> dict[str, Any]:
        """Returns everything that learning changes as tensors, for :meth:`restore`."""

    @abstractmethod
    def restore(self, state: dict[str, Any]) -> None:
        """Restores a :meth:`state`."""


class OverlappedLearner(ABC):
    """A run: its races, networks and files.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        facts: type of the facts in a checkpoint, a :class:`RunFacts` with ``recent``.
        may_change: whether to continue even if the run had other arguments.

    Attributes:
        remedy: another remedy to suggest if the run had other arguments.

    Raises:
        ConfigError: the folder cannot be created, another program uses it, or it contains a run
            with other arguments; or an argument is invalid.
    """

    remedy: ClassVar[str] = ""
    arguments: OverlappedArguments

    def __init__(
        self,
        folder: str | Path,
        arguments: OverlappedArguments,
        facts: type[Any],
        *,
        may_change: bool = False,
    ) -> None:
        self.folder, self.arguments = Path(folder), arguments
        with ExitStack() as resources:
            resources.enter_context(locked_folder(self.folder, "run"))
            checkpoint = load_checkpoint(self.folder, facts)
            self._network = self._new_network() if checkpoint else self._first_network()
            self.kart_steps = self.iteration = 0
            self._recent: deque[Any] = deque(maxlen=_RECENT)
            self._history: list[dict[str, Any]] = [self._chapter()]
            if checkpoint:
                self._restore(*checkpoint, may_change)
            write_json(self.folder / ARGUMENTS, self._history)
            self._actors, self._rollouts = self._start_actors()
            resources.callback(self._actors.close)
            self.begin_races()
            self._resources = resources.pop_all()

    @abstractmethod
    def _new_network(self) -> LearningNetwork:
        """Returns new networks."""

    def _first_network(self) -> LearningNetwork:
        """Returns the networks of a new run, with its initial weights if these come from a file."""
        return self._new_network()

    @abstractmethod
    def _start_actors(self) -> tuple[ActorPool, list[npt.NDArray[np.void]]]:
        """Starts the actors.

        Their ``begin(seed)`` starts new races. Their ``drive(number, policy, critic)`` fills the
        rollout ``number`` and returns a :class:`RolloutResult`.

        Returns:
            The actors, and two rollouts ``(2, T, S)`` of each.
        """

    def _rules(self) -> dict[str, Any]:
        """Returns rules that, like the arguments, must not change when a run continues."""
        return {}

    @abstractmethod
    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], driven: Sequence[RolloutResult]
    ) -> dict[str, float]:
        """Updates the networks.

        Args:
            rollouts: a rollout ``(T, S)`` of each actor.
            driven: its other results.

        Returns:
            Figures for the log.
        """

    @abstractmethod
    def _figures(self) -> dict[str, float]:
        """Returns figures about the recent finishes for the log."""

    def begin_races(self) -> None:
        """Starts new races; later random numbers derive from seed and iteration."""
        seed = self.arguments.seed
        self._random = np.random.default_rng([seed, self.iteration])
        self._actors.forget()
        seeds = [([seed, self.iteration, number],) for number in range(len(self._actors))]
        self._actors.call("begin", seeds)

    def iterate(self) -> dict[str, float]:
        """Updates the networks with a rollout; returns the log entry."""
        begin = time.perf_counter()
        if not self._actors.is_busy:
            self._drive(self.iteration)
        driven = self._driven()
        rollouts = [memory[self.iteration % 2] for memory in self._rollouts]
        is_changed = self.iteration == 0 and self._network.prepare(
            np.concatenate([rollout[rollout["active"]] for rollout in rollouts])
        )
        is_last = self.is_checkpoint(self.iteration + 1)
        if not (is_changed or is_last or self.arguments.on_policy):
            self._drive(self.iteration + 1)
        waited = time.perf_counter()
        learned = self._update(rollouts, driven)
        for own in driven:
            self._recent.extend(own.finishes)
        self.iteration += 1
        steps = int(sum(rollout["active"].sum() for rollout in rollouts))
        self.kart_steps += steps
        end = time.perf_counter()
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            **self._figures(),
            **learned,
            "wait_s": waited - begin,
            "learn_s": end - waited,
            "kart_steps_per_s": steps / (end - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def is_checkpoint(self, iteration: int) -> bool:
        """Returns whether a checkpoint follows an iteration; all races restart after it."""
        return iteration % self.arguments.checkpoint_every == 0

    def _drive(self, iteration: int) -> None:
        """Lets the actors drive the rollout of an iteration with the current networks."""
        call = (iteration % 2, *self._network.weights(), *self._drive_options())
        self._actors.send("drive", [call] * len(self._actors))

    def _drive_options(self) -> tuple[Any, ...]:
        """Returns more arguments of the actors' ``drive``."""
        return ()

    def _driven(self) -> list[RolloutResult]:
        """Waits for the actors' rollouts."""
        return self._actors.receive()

    # ------------------------------------------------------------------ files

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``; call :meth:`begin_races` next, as a resumed run does."""
        save_checkpoint(self.folder, self._facts(), {"network": self._network.state()})

    def save_policy(self, path: Path | None = None) -> Path:
        """Writes the current policy, by default to the run's folder; returns its path."""
        path = path or self.folder / f"{policy_name(self.kart_steps)}.safetensors"
        save_weights(path, self._network.weights()[0])
        return path

    def _facts(self) -> dict[str, Any]:
        """Returns the facts of a checkpoint as JSON values."""
        return {
            "history": self._history,
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "recent": [asdict(finish) for finish in self._recent],
        }

    def close(self) -> None:
        """Ends all races, and unlocks the folder."""
        self._resources.close()

    def _chapter(self, kart_steps: int = 0) -> dict[str, Any]:
        """Returns the arguments that apply from a number of kart-steps on."""
        rules = self._rules()
        own = {"from": kart_steps, "arguments": asdict(self.arguments)}
        return {**own, "rules": rules} if rules else own

    def _restore(self, facts: Any, state: dict[str, Any], may_change: bool) -> None:
        self._history = facts.history
        now, last = self._chapter(facts.kart_steps), self._history[-1]
        new = now.get("rules", {})
        rules = {name: last.get("rules", {}).get(name) for name in new}
        if check_resumed(
            self.folder,
            {**last["arguments"], **rules},
            {**now["arguments"], **new},
            self.remedy,
            may_change=may_change,
        ):
            self._history.append(now)
        self.kart_steps, self.iteration = facts.kart_steps, facts.iteration
        remove_later_policies(self.folder, self.kart_steps)
        self._recent.extend(facts.recent)
        with reading_checkpoint(self.folder):
            self._network.restore(state["network"])


def train(learner: OverlappedLearner, total: int, shown: Sequence[str]) -> Path:
    """Learns until a number of kart-steps, with a progress bar, a log, checkpoints and policies.

    Args:
        learner: the run.
        total: the number of kart-steps.
        shown: figures of the log to show.

    Returns:
        The file of the last policy.
    """
    keep_every = learner.arguments.keep_every
    with (
        TrainingLog(learner.folder, learner.iteration) as log,
        ProgressBar(total, learner.kart_steps) as bar,
    ):
        while learner.kart_steps < total:
            before = learner.kart_steps
            line = learner.iterate()
            log.write(line)
            figures = [f"{name} {line[name]:.3f}" for name in shown if name in line]
            text = f"{'  '.join(figures)}  {line['kart_steps_per_s']:.0f}/s"
            bar.report(learner.kart_steps, text)
            if learner.kart_steps // keep_every > before // keep_every:
                learner.save_policy()
            if learner.is_checkpoint(learner.iteration):
                learner.save_checkpoint()
                learner.begin_races()
        learner.save_checkpoint()
        return learner.save_policy()
