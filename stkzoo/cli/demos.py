"""Record demonstrations to learn from.

Records the observations and actions of a driver, in a view of your choice, to one file. Use it
for behavior cloning, offline reinforcement learning or to initialize reinforcement learning.

The driver is the game's AI (ai), a driver that comes with stkzoo (heuristic, pretrained:ace), or
your own agent (a folder, a zip, a module). The driver itself can use another view. All its karts
are recorded. Each race is stored as soon as it ends. After an interruption, the same command
resumes.

Read the file with stkzoo.evaluation.load_demonstrations(path), or any reader of safetensors.

Examples:
  stkzoo demos heuristic             15 training tracks, in demos.safetensors
  stkzoo demos ai --difficulty 3 --seeds 5 --output ai.safetensors
  stkzoo demos heuristic --rivals ai ai --karts 1 --view flattened_discrete
  stkzoo demos planner --karts 1     plans with the game; slow
  stkzoo demos my_agent/ --track lighthouse hacienda

exit codes:
  0 success, 1 a race could not be recorded, 2 invalid command line, 130
  interrupted
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from stkzoo._arguments import option, options_of, positional
from stkzoo._checks import check_whole
from stkzoo.cli._batch import (
    BatchArguments,
    directions_option,
    reverse_of,
    run_batch,
    tracks_option,
)
from stkzoo.evaluation import (
    DemoPlan,
    plan_demonstrations,
)
from stkzoo.evaluation.demonstrations.plan import run_planned_demonstrations
from stkzoo.race import RaceSettings


@dataclass
class DemosArguments:
    """Options of ``stkzoo demos``.

    Attributes:
        agent: the driver; see above
        view: view to record: racing, simple, flattened_discrete, ...
        seeds: races of each track and direction
        first_seed: seed of the first of these races
        karts: number of karts that the driver drives in a race
        rivals: drivers of the other karts
        output: file of the dataset
    """

    agent: str = positional()
    view: str = "racing"
    tracks: tuple[str, ...] = tracks_option()
    directions: tuple[str, ...] = directions_option("forward")
    seeds: int = 1
    first_seed: int = 0
    karts: int = 4
    rivals: tuple[str, ...] = option((), metavar="DRIVER")
    output: Path = option(Path("demos.safetensors"), metavar="FILE")
    batch: BatchArguments = options_of(BatchArguments)
    settings: dict[str, Any] = options_of(RaceSettings, without=DemoPlan.decided, group="each race")


def run(arguments: DemosArguments) -> int:
    """Records demonstrations."""
    plan, file = _plan(arguments), arguments.output
    demos, code = run_batch(arguments.batch, partial(run_planned_demonstrations, plan, file))
    if demos is not None:
        finished = sum(facts.finish_time is not None for facts in demos.facts)
        print(
            f"{file}: {len(demos)} drives ({finished} finished), {demos.num_steps:,} steps, view "
            f"{demos.view}\nread it with stkzoo.evaluation.load_demonstrations({str(file)!r})"
        )
    return code


def _plan(arguments: DemosArguments) -> DemoPlan:
    check_whole("seeds", arguments.seeds, 1)
    check_whole("first-seed", arguments.first_seed, 0)
    return plan_demonstrations(
        arguments.agent,
        view=arguments.view,
        tracks=arguments.tracks,
        karts=arguments.karts,
        rivals=arguments.rivals,
        reverse=reverse_of(arguments.directions),
        seeds=range(arguments.first_seed, arguments.first_seed + arguments.seeds),
        **arguments.settings,
    )
