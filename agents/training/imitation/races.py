"""Races in which a learner drives and its teacher says what it would have done."""

from __future__ import annotations

import math
import multiprocessing
import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.evaluation import DemoView
from stkzoo.mdp import kart_action_space, kart_observation_space
from stkzoo.race import Driver, DriverInstance, DriverRequest, find_driver, run_race
from stkzoo.race.replay import action_of, controls_of
from stkzoo.wrappers.racing import controls_of_choices

from ..common.fleet import ai_time
from .lessons import Lesson, Numbers

#: A learner's race is cut short after so many times the AI's median time.
PATIENCE = 1.7
#: What a kart counts as that has not finished by then.
UNFINISHED = 2.0
_STEP, _COUNTDOWN = 0.1, 20


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


def drive_race(
    teacher: str, policy: str, karts: int, difficulty: int, track: str, seed: int
) -> Lesson:
    """Drives a race, in which all karts are the learner's.

    Args:
        teacher: says what is right; a text for :func:`~stkzoo.race.find_driver`.
        policy: file of the learner's weights.
        karts: how many.
        difficulty: which of the AI's times to compare with.
        track: where.
        seed: of the race.
    """
    driver, view = load_driver(policy), DemoView("racing")
    seen: list[Numbers] = []
    labels: list[Numbers] = []

    def make_actor(
        _: spaces.Space[Any], __: spaces.Space[Any], seed: int
    ) -> Callable[[Any], dict[str, Any]]:
        instance = _instance(teacher, seed)

        def act(observation: Any) -> dict[str, Any]:
            own = view.observe(observation)
            instance.ask(observation)
            answer = np.array(controls_of(instance.answer().action), np.float32)
            seen.append(own)
            labels.append(view.action(observation, answer))
            return action_of(controls_of_choices(driver.best(own[None]))[0])

        return act

    median = ai_time(track, False, difficulty)
    result = run_race(
        [Driver.of_actor(f"learner {kart}", make_actor) for kart in range(karts)],
        track=track,
        seed=seed,
        error_handling="raise",
        max_steps=_COUNTDOWN + math.ceil(PATIENCE * median / _STEP),
        action_timeout=None,
    )
    times = [row.finish_time for row in result.agents]
    ratios = tuple(time_ratio(time, track, False, difficulty) for time in times)
    finished = sum(time is not None for time in times)
    return Lesson(np.array(seen, np.float32), np.array(labels, np.int8), ratios, finished)


def _instance(teacher: str, seed: int) -> DriverInstance:
    """The teacher, ready to be asked."""
    start = find_driver(teacher, inline=True).start
    assert start is not None  # noqa: S101 - checked before
    instance = start(DriverRequest("kart_0", kart_observation_space(), kart_action_space(), seed))
    instance.ready()
    return instance
