"""The intended differences between stkzoo and pystk2-gymnasium, in ``INTENDED``."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.parity.reference import Job
from stkzoo.engine.track import TrackMap


@dataclass(frozen=True)
class RaceContext:
    """Information about a race in addition to the two recordings.

    Attributes:
        job: the race.
        track: track of the race.
        nodes: track node of each agent's kart, by moment.
        finished: whether each agent had finished before the moment, by moment.
    """

    job: Job
    track: TrackMap
    nodes: Sequence[Sequence[int]]
    finished: Sequence[Sequence[bool]]


@dataclass(frozen=True)
class Difference:
    """An entry that differs.

    Attributes:
        aspect: ``missing`` or ``extra`` in ours, ``space``, ``type``, ``value`` or ``order``.
        path: path of the entry, such as ``observation/...``, ``info/...`` or ``reward``.
        step: number of the moment; -1 for spaces.
        text: description of both sides.
        ours: our value, if there is one.
        theirs: the reference's value, if there is one.
    """

    aspect: str
    path: str
    step: int
    text: str
    ours: npt.NDArray[np.float64] | None = None
    theirs: npt.NDArray[np.float64] | None = None

    @property
    def agent(self) -> int:
        """Number of the agent to which the entry belongs."""
        match = re.search(r"/(\d+)(/|$)", self.path)
        return int(match[1]) if match else 0


Check = Callable[[Difference, RaceContext], bool]


@dataclass(frozen=True)
class Intended:
    """An intended difference.

    Attributes:
        code: short name in reports; D numbers are defects of the reference.
        why: reason for the difference.
        aspects: aspects that it covers, separated by spaces.
        path: regular expression that matches the whole path.
        env_id: regular expression that matches a part of the environment id.
        needs_ai: whether it applies only to races in which the game drives an agent.
        check: additional condition on the difference.
    """

    code: str
    why: str
    aspects: str
    path: str
    env_id: str = ""
    needs_ai: bool = False
    check: Check = lambda _difference, _context: True

    def covers(self, difference: Difference, context: RaceContext) -> bool:
        """Returns whether this entry explains a difference."""
        return (
            difference.aspect in self.aspects.split()
            and re.fullmatch(self.path, difference.path) is not None
            and re.search(self.env_id, context.job.env_id) is not None
            and (not self.needs_ai or any(context.job.use_ai))
            and self.check(difference, context)
        )


def _agent_had_finished(difference: Difference, context: RaceContext) -> bool:
    return context.finished[difference.step][difference.agent]


def _is_not_paid_again(difference: Difference, context: RaceContext) -> bool:
    return _agent_had_finished(difference, context) and difference.ours == 0


def _some_had_finished(difference: Difference, context: RaceContext) -> bool:
    return any(context.finished[difference.step])


def _is_one_step_up(difference: Difference, _: RaceContext) -> bool:
    if difference.ours is None or difference.theirs is None:
        return False
    return bool(np.all(np.isin(difference.ours - difference.theirs, (0, 1))))


def _pipe_drops_it(difference: Difference, context: RaceContext) -> bool:
    dropped = 3 if difference.path.endswith("phase") else 0
    return context.job.use_subprocess and difference.theirs == dropped


def _is_number_of_choices(difference: Difference, _: RaceContext) -> bool:
    """Returns whether our number encodes their choices, up to one step of discretized ones."""
    if difference.ours is None or difference.theirs is None:
        return False
    counts = (5, 2, 2, 2, 2, 2, 7)
    choices = np.array(np.unravel_index(int(difference.ours), counts, order="F"), float)
    apart = choices - difference.theirs
    return bool(np.isin(apart[[0, 6]], (0, 1)).all() and not apart[1:6].any())


#: All intended differences. ``compare`` reports all others as undocumented.
INTENDED = (
    Intended(
        "D08",
        "the flattened views have no text entry, which most learners reject",
        "missing space",
        r"(observation|observation_space)/kart_type",
        "flattened",
    ),
    Intended(
        "D15",
        "the space includes kart names with an underscore",
        "space",
        r"observation_space/(\d+/)?kart_type",
    ),
    Intended(
        "D15",
        "the space allows 9 power-ups, because the game gives more than 5",
        "space",
        r"observation_space/((\d+/)?powerup_count|discrete)",
    ),
    Intended(
        "D09",
        "the space of every view includes the action of an AI agent",
        "space",
        r"observation_space/(action.*|)",
        needs_ai=True,
    ),
    Intended(
        "D09",
        "the continuous view of an AI agent has its observation besides the action",
        "extra",
        r"observation/(continuous|discrete)(/.*)?",
        "flattened_continuous_actions",
        needs_ai=True,
    ),
    Intended(
        "D09",
        "the discrete view gives an AI agent's action as the number of its action space",
        "type value",
        r"observation/action",
        "flattened_discrete",
        needs_ai=True,
        check=_is_number_of_choices,
    ),
    Intended(
        "D07",
        "numbers are rounded to the nearest step, not down",
        "value",
        r"observation/action",
        "flattened_multidiscrete",
        needs_ai=True,
        check=_is_one_step_up,
    ),
    Intended(
        "D31",
        "the phase and the ticks are those of the game, even if it runs in its own process",
        "value",
        r"observation/((\d+/)?|continuous/|discrete/)(phase|aux_ticks)",
        check=_pipe_drops_it,
    ),
    Intended(
        "type",
        "an AI agent's buttons are integers, as in the space, not bool",
        "type",
        r"observation/(\d+/)?action(/(brake|drift|fire|nitro|rescue|discrete))?",
        needs_ai=True,
    ),
    Intended(
        "type",
        "item types are int64 as in the space, not int32",
        "type",
        r"observation/(\d+/)?items_type",
    ),
    Intended(
        "type",
        "a distance of 0 is the number 0.0, not the int 0",
        "type",
        r"info/(infos/\d+/)?distance",
        check=lambda difference, _: difference.ours == 0 and difference.theirs == 0,
    ),
    Intended(
        "D16",
        "track segments come nearest first along the track",
        "order",
        r"observation/((\d+/)?|continuous/)paths_.*",
    ),
    Intended(
        "tie",
        "objects at the same distance, up to rounding, may swap places",
        "order",
        r"observation/((\d+/)?|continuous/|discrete/)(items|karts)_.*",
    ),
    Intended(
        "tie",
        "a line straight ahead may count as left or right, because of rounding",
        "order",
        r"observation/((\d+/)?|continuous/)center_path_distance",
    ),
    Intended(
        "D05",
        "a finished agent gets no further reward",
        "value",
        r"info/reward/\d+",
        "multi-full",
        check=_is_not_paid_again,
    ),
    Intended(
        "D05",
        "a finished agent gets no further reward, so the sum is smaller",
        "value",
        r"reward",
        "multi-full",
        check=_some_had_finished,
    ),
    Intended(
        "D06",
        "the info says for every agent whether it is done",
        "extra",
        r"info/done/\d+",
        "multi-full",
    ),
    Intended(
        "info",
        "infos have more entries, and the same entries after reset and after a step",
        "extra",
        r"info/(infos/\d+/)?(lap|finish_time|(episode/)?reward/[a-z]+|episode/(return|length))",
    ),
    Intended(
        "info",
        "the infos of a finished agent do not change after its finish",
        "value",
        r"info/infos/\d+/(distance|position)",
        "multi-full",
        check=_agent_had_finished,
    ),
    Intended(
        "info",
        "reset returns the same infos as a step",
        "extra",
        r"info/((infos/\d+/)?(position|distance)|(reward|terminated)/\d+)",
        check=lambda difference, _: difference.step == 0,
    ),
)
