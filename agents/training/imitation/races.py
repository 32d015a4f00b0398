"""Races in which a learner drives and its teacher says what it would have done."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._os import atomic_write
from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.errors import ConfigError
from stkzoo.evaluation import DemoView
from stkzoo.mdp import kart_action_space, kart_observation_space
from stkzoo.race import Driver, DriverInstance, DriverRequest, find_driver, run_race
from stkzoo.race.replay import action_of, controls_of
from stkzoo.wrappers.racing import controls_of_choices

from ..common.fleet import ai_time

#: A learner's race is cut short after so many times the AI's median time.
PATIENCE = 1.7
#: What a kart counts as that has not finished by then.
UNFINISHED = 2.0
_STEP, _COUNTDOWN = 0.1, 20

Numbers = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class LessonOrder:
    """A race to drive.

    Attributes:
        teacher: who says what is right; a text for :func:`~stkzoo.race.find_driver`.
        policy: file of the learner's weights.
        track: where.
        reverse: the other way round.
        seed: of the race.
        karts: of the learner.
        difficulty: which of the AI's times to compare with.
        file: where the lesson goes.
    """

    teacher: str
    policy: str
    track: str
    reverse: bool
    seed: int
    karts: int
    difficulty: int
    file: str


@dataclass(frozen=True, slots=True)
class Lesson:
    """What came of a race: ``N`` moments of all karts together.

    Attributes:
        observations: ``(N, 165)`` float32, in the view ``racing``.
        actions: ``(N, 5)``: what the teacher would have done then.
        ratios: of each kart's time to the AI's; :data:`UNFINISHED` for one that did not finish.
        finished: how many did.
        track: where.
    """

    observations: Numbers
    actions: Numbers
    ratios: tuple[float, ...]
    finished: int
    track: str


def end_with_parent() -> None:
    """Ends this process, whatever it does, when the one that started it is gone."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def time_ratio(time: float | None, track: str, reverse: bool, difficulty: int) -> float:
    """A finish time over the AI's median time there."""
    if time is None:
        return UNFINISHED
    return min(time / ai_time(track, reverse, difficulty), UNFINISHED)


def run_order(order: LessonOrder) -> str:
    """Drives a race and keeps its lesson in a file; the track's name."""
    driver, view = load_driver(order.policy), DemoView("racing")
    seen: list[Numbers] = []
    labels: list[Numbers] = []

    def make_actor(
        _: spaces.Space[Any], __: spaces.Space[Any], seed: int
    ) -> Callable[[Any], dict[str, Any]]:
        teacher = _instance(order.teacher, seed)

        def act(observation: Any) -> dict[str, Any]:
            own = view.observe(observation)
            teacher.ask(observation)
            answer = np.array(controls_of(teacher.answer().action), np.float32)
            seen.append(own)
            labels.append(view.action(observation, answer))
            choices = driver.best(own[None])
            return action_of(controls_of_choices(choices)[0])

        return act

    median = ai_time(order.track, order.reverse, order.difficulty)
    result = run_race(
        [Driver.of_actor(f"learner {kart}", make_actor) for kart in range(order.karts)],
        track=order.track,
        reverse=order.reverse,
        seed=order.seed,
        error_handling="raise",
        max_steps=_COUNTDOWN + math.ceil(PATIENCE * median / _STEP),
        action_timeout=None,
    )
    times = [row.finish_time for row in result.agents]
    ratios = [time_ratio(time, order.track, order.reverse, order.difficulty) for time in times]
    facts = {
        "track": order.track,
        "ratios": ratios,
        "finished": sum(time is not None for time in times),
    }
    with atomic_write(order.file) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            observations=np.array(seen, np.float32),
            actions=np.array(labels, np.int8),
            about=np.array(json.dumps(facts)),
        )
    return order.track


def read_lesson(path: str | os.PathLike[str]) -> Lesson:
    """Reads what :func:`run_order` kept.

    Raises:
        ConfigError: the file is damaged.
    """
    try:
        with Path(path).open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            facts = json.loads(str(file["about"]))
            return Lesson(
                file["observations"],
                file["actions"].astype(np.int64),
                tuple(facts["ratios"]),
                facts["finished"],
                facts["track"],
            )
    except (OSError, ValueError, KeyError, TypeError, EOFError) as error:
        raise ConfigError(
            f"{path} is unreadable ({error}); delete it to drive the race again"
        ) from error


def _instance(teacher: str, seed: int) -> DriverInstance:
    """The teacher, ready to be asked."""
    start = find_driver(teacher, inline=True).start
    assert start is not None  # noqa: S101 - checked before
    instance = start(DriverRequest("kart_0", kart_observation_space(), kart_action_space(), seed))
    instance.ready()
    return instance
