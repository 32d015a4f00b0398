"""A check that replays demonstrations: the same controls must lead to the same observations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stkzoo.drivers.driver import GAME_AI, find_driver
from stkzoo.errors import ConfigError, shortened
from stkzoo.evaluation.demonstrations.dataset import Columns, Demonstrations, is_by_step
from stkzoo.evaluation.demonstrations.plan import DemoPlan, demo_orders
from stkzoo.evaluation.demonstrations.recorder import Controls, DemoRecorder, DemoView
from stkzoo.race.replay import recorded_driver
from stkzoo.race.runner import run_race


@dataclass(frozen=True, slots=True)
class DemoCheck:
    """The outcome of the check of one race.

    Attributes:
        race: number of the race.
        steps: total number of compared steps of all karts.
        first_difference: number of the first step after which any kart's observation differs, 0
            for the observation on the grid; ``None`` if all are bit-identical.
    """

    race: int
    steps: int
    first_difference: int | None

    @property
    def is_exact(self) -> bool:
        """Whether all observations are bit-identical."""
        return self.first_difference is None


def check_demonstrations(
    demos: Demonstrations, race: int = 0, *, trust_rivals: bool = False
) -> DemoCheck:
    """Replays the recorded controls of one race in the game, and compares the observations.

    Args:
        demos: the dataset.
        race: number of the race in the dataset.
        trust_rivals: whether to run rivals from files. The dataset names these files, and whether
            they run in a sandbox, so use this only for a dataset that you trust.

    Raises:
        ConfigError: there is no such race; a rival comes from files, which are not trusted; or the
            game's AI drove the race. The AI decides twelve times per step and gets boosts that
            agents do not get, so its races cannot be replayed.
    """
    plan = DemoPlan.from_dict(demos.plan)
    numbers = [number for number, facts in enumerate(demos.facts) if facts.race == race]
    orders = demo_orders(plan)
    if not numbers or race >= len(orders):
        raise ConfigError(f"the dataset has no race {race}; it has {len(orders)} races")
    if plan.agent.source in GAME_AI:
        raise ConfigError(
            "races of the game's AI cannot be driven again by its actions; check demonstrations of "
            "another driver"
        )
    settings = orders[race].settings
    if not any(find_driver(rival).is_from_files for rival in plan.rivals):
        settings = replace(settings, adapter=None)
    elif not trust_rivals:
        raise ConfigError(
            f"the dataset has rivals from files, {shortened(plan.rivals, 200)}, whose code would "
            "run; if you trust the dataset, use trust_rivals=True"
        )
    view = DemoView(plan.view)
    recorder = DemoRecorder(plan.karts, view, race=race)
    longest = int(max(demos.lengths[numbers]))
    drivers = [
        recorded_driver("recorded", _padded(demos[number].controls, longest)) for number in numbers
    ]
    run_race(
        [*drivers, *plan.rivals],
        listeners=[recorder],
        wait_for=range(plan.karts),
        settings=replace(settings, max_steps=longest),  # the controls last no longer
    )
    again = recorder.episodes(demos.plan)
    firsts = [
        _first_difference(demos.episode_columns(number), again.episode_columns(index))
        if again is not None and index < len(again)
        else 0
        for index, number in enumerate(numbers)
    ]
    steps = sum(int(demos.lengths[number]) for number in numbers)
    return DemoCheck(race, steps, min((n for n in firsts if n is not None), default=None))


def _padded(controls: Controls, steps: int) -> Controls:
    """Returns controls ``(T, 7)`` with zeros up to a number of steps.

    A kart that differs from the recording may need controls after its recorded finish.
    """
    return np.pad(controls, ((0, steps - len(controls)), (0, 0)))


def _first_difference(one: Columns, other: Columns) -> int | None:
    """Returns the index of the first observation in which two episodes differ, or ``None``."""
    names = [name for name in one if not is_by_step(name)]
    lengths = len(one[names[0]]), len(other[names[0]])
    count = min(lengths)
    differs = np.zeros(count, np.bool_)
    for name in names:
        differs |= (one[name][:count] != other[name][:count]).reshape(count, -1).any(axis=1)
    if differs.any():
        return int(differs.argmax())
    return None if lengths[0] == lengths[1] else count
