"""What an entry says about its agent: its class, how it was trained, who made it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from stkzoo._arguments import option
from stkzoo._checks import check_name, check_whole, shortened
from stkzoo._reading import load_json
from stkzoo._schema import Count, distinct_name, one_of, plain_name
from stkzoo.drivers.driver import GAME_AI, driver_names
from stkzoo.errors import ConfigError

#: The classes of agents, which are ranked apart.
LEARNED, SCRIPTED, SEARCH = CLASSES = ("learned", "scripted", "search")
#: Drivers that come with stkzoo and use copies of the race while they drive.
_SEARCHERS = {"planner"}
_LEARNED_NAMES = "pretrained:"
#: File about the training in the folder of an agent (``stkzoo.agents.training.export``).
_CARD = "card.json"
#: Log of a training run in its folder, which also contains its agent and entries of this agent.
TRAINING_LOG = "log.jsonl"
#: Maximum length of a text, and of a name [characters], and maximum of a number.
_MAX_TEXT, _MAX_NAME, _MAX_NUMBER = 2000, 40, 2**62
_MAX_SHOWN = 80
_Text = Annotated[str, Meta(max_length=_MAX_TEXT)]
_Name = Annotated[str, Meta(max_length=_MAX_NAME)]


@dataclass(frozen=True, slots=True)
class About:
    """What an entry says about its agent. Only the class of a driver of stkzoo can be verified.

    Attributes:
        authors: names of the authors, at most 2,000 characters.
        description: how the agent was made, and where to find it; at most 2,000 characters.
        agent_class: learned, scripted, or search: it uses copies of the race while it drives
            (default: that of a driver of stkzoo or of an agent of its training programs).
        demonstrations: it learned from demonstrations.
        pretraining: what it had learned before its kart-steps, at most 2,000 characters.
        kart_steps: number of kart-steps that it learned from (default: unknown).
        algorithm: name of its training algorithm, at most 40 characters; a report compares
            algorithms.
        training_seed: seed of its training run.
        variant: name of this evaluation if the agent has several, such as argmax; at most 40
            characters.

    Raises:
        ConfigError: a value is invalid.
    """

    authors: _Text = ""
    description: _Text = ""
    agent_class: Annotated[str, one_of(*CLASSES)] | None = option(flag="--class", choices=CLASSES)
    demonstrations: bool = False
    pretraining: _Text = ""
    kart_steps: Count | None = None
    algorithm: _Name = ""
    training_seed: Count | None = None
    variant: _Name = ""

    def __post_init__(self) -> None:
        texts = dict.fromkeys(("authors", "description", "pretraining"), _MAX_TEXT)
        for name, most in (texts | dict.fromkeys(("algorithm", "variant"), _MAX_NAME)).items():
            text = getattr(self, name)
            if not isinstance(text, str) or len(text) > most:
                raise ConfigError(
                    f"{name} is {shortened(text)}, expected text of at most {most:,} characters"
                )
        if self.agent_class is not None:
            check_name("class", self.agent_class, CLASSES)
        for name in ("kart_steps", "training_seed"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 0, _MAX_NUMBER)

    @property
    def summary(self) -> str:
        """Class, demonstrations and pretraining in one line, as in ``learned, demonstrations``."""
        before = plain_name(self.pretraining, _MAX_SHOWN).replace("|", "/")
        parts = (self.agent_class, "demonstrations" * self.demonstrations, before)
        return ", ".join(filter(None, parts))

    def completed(self, source: str) -> About:
        """Returns the same with the class of a driver of stkzoo, or with the facts on a card.

        Args:
            source: name or path of the agent.
        """
        shipped = shipped_class(source)
        facts: dict[str, Any] = {"agent_class": shipped} if shipped else _facts(source)
        unsaid = {name: fact for name, fact in facts.items() if getattr(self, name) in (None, "")}
        return replace(self, **unsaid)

    def check(self, source: str, label: str) -> None:
        """Checks that the class and the name do not contradict the agent.

        Args:
            source: name or path of the agent.
            label: its name in the entry.

        Raises:
            ConfigError: an agent from files has no class or the name of a driver of stkzoo, or a
                driver of stkzoo has another class.
        """
        shipped = shipped_class(source)
        if self.agent_class is None:
            raise ConfigError(
                f"{label!r} has no class; choose one of {', '.join(CLASSES)} (--class)"
            )
        if shipped not in (None, self.agent_class):
            raise ConfigError(
                f"{source!r} comes with stkzoo and its class is {shipped}, not {self.agent_class}; "
                "leave out the class (--class)"
            )
        name = plain_name(label)
        if distinct_name(name, {*GAME_AI, *driver_names()} - {source}) != name:
            raise ConfigError(
                f"the agent {shortened(source)} is called {label!r}, like a driver of stkzoo; give "
                "it another name, such as AGENT@:Nova"
            )


def shipped_class(source: str) -> str | None:
    """Returns the class of a driver that comes with stkzoo; ``None`` for other agents.

    Args:
        source: name or path of the agent.
    """
    if source not in {*GAME_AI, *driver_names()}:
        return None
    if source.startswith(_LEARNED_NAMES):
        return LEARNED
    return SEARCH if source in _SEARCHERS else SCRIPTED


@dataclass(frozen=True, slots=True)
class _TrainingArguments:
    """The arguments of a training program that identify a run."""

    algorithm: _Name = ""
    seed: Count | None = None


@dataclass(frozen=True, slots=True)
class _TrainingPart:
    """A part of a run with the same arguments."""

    arguments: _TrainingArguments


@dataclass(frozen=True, slots=True)
class _TrainingRun:
    """A run whose weights an agent has."""

    history: tuple[_TrainingPart, ...]
    kart_steps: Count | None = None


@dataclass(frozen=True, slots=True)
class _AgentCard:
    """What an agent's card says about its training, and the name of its variant."""

    runs: tuple[_TrainingRun, ...] = ()
    variant: _Name = ""


def _facts(source: str) -> dict[str, Any]:
    """Returns facts about an agent from the card of its training, by field of :class:`About`."""
    try:
        card = load_json(Path(source, _CARD), _AgentCard)
    except (OSError, ValueError):  # no card, or one of another program
        return {}
    if len(card.runs) != 1 or not card.runs[0].history:
        return {"agent_class": LEARNED} if card.runs else {}
    (run,) = card.runs
    arguments = run.history[-1].arguments
    return {
        "agent_class": LEARNED,
        "kart_steps": run.kart_steps,
        "algorithm": arguments.algorithm,
        "training_seed": arguments.seed,
        "variant": card.variant,
    }
