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
from pathlib import Path
from typing import Any

from stkzoo._arguments import option, options_of, positional
from stkzoo.cli._batch import RUN_OPTIONS, directions_option, reverse_of, run_batch, tracks_option
from stkzoo.evaluation import DemoPlan, RunOptions, plan_demonstrations
from stkzoo.evaluation.demonstrations.plan import run_planned_demonstrations
from stkzoo.race import RaceSettings


@dataclass
class RecordedRacesArguments:
    """Options of the races to record.

    Attributes:
        agent: the driver; see above
        view: view to record: racing, simple, flattened_discrete, ...
        seeds: races of each track and direction
        karts: number of karts that the driver drives in a race
        rivals: drivers of the other karts
    """

    agent: str = positional()
    view: str = "racing"
    tracks: tuple[str, ...] = tracks_option()
    seeds: int = 1
    karts: int = 4
    rivals: tuple[str, ...] = option((), metavar="DRIVER")


@dataclass
class DemosArguments:
    """Options of ``stkzoo demos``.

    Attributes:
        output: file of the dataset
    """

    races: RecordedRacesArguments = options_of(RecordedRacesArguments)
    directions: tuple[str, ...] = directions_option("forward")
    output: Path = option(Path("demos.safetensors"), metavar="FILE")
    batch: dict[str, Any] = options_of(RunOptions, only=RUN_OPTIONS)
    settings: dict[str, Any] = options_of(RaceSettings, without=DemoPlan.decided, group="each race")


def run(arguments: DemosArguments) -> int:
    """Records demonstrations."""
    reverse, file = reverse_of(arguments.directions), arguments.output
    plan = plan_demonstrations(**vars(arguments.races), reverse=reverse, **arguments.settings)
    demos, code = run_batch(
        arguments.batch,
        lambda **options: run_planned_demonstrations(plan, file, RunOptions(**options)),
    )
    if demos is not None:
        finished = sum(facts.finish_time is not None for facts in demos.facts)
        print(
            f"{file}: drives {len(demos)} ({finished} finished), steps {demos.num_steps:,}, view "
            f"{demos.view}\nread it with stkzoo.evaluation.load_demonstrations({str(file)!r})"
        )
    return code
