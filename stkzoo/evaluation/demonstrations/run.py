"""Records demonstrations, or goes on with that.

Each race is a file of its own as soon as it is over, in a folder beside the data set; when all are
there they become the data set, and the folder goes.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from stkzoo._os import cpu_count
from stkzoo.errors import ConfigError, StkzooError, check_whole
from stkzoo.evaluation.batch import (
    RACE_TIMEOUT,
    BatchFolder,
    BatchProgress,
    ProgressListener,
    errors_in_words,
)
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.demonstrations.dataset import Demonstrations, join, load, save
from stkzoo.evaluation.demonstrations.plan import DEMOS, DemoOrder, DemoPlan, plan_demos
from stkzoo.race.result import RaceResult

__all__ = ["DemosError", "parts_folder", "record", "record_plan"]

_ENDING = ".npz"


class DemosError(StkzooError):
    """Some races could not be recorded; the others are kept."""


def record(
    agent: str = "heuristic",
    *,
    output: str | os.PathLike[str],
    jobs: int | None = None,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **plan: Any,
) -> Demonstrations:
    """Records a driver's races as a data set, or goes on with that.

    Args:
        agent: who is recorded; see :func:`~stkzoo.evaluation.demonstrations.plan_demos`.
        output: the data set's file, whose name ends in ``.npz``. While races are run they are
            kept in a folder beside it, ``output.parts``; the same call goes on after an
            interruption.
        jobs: how many races at a time; by default as many as there are processors. It changes
            nothing in the data set.
        race_timeout: for one race [s].
        on_race: is told of every race.
        plan: ``view``, ``tracks``, ``reverse``, ``seeds``, ``karts``, ``rivals``,
            ``substeps`` and fields of :class:`~stkzoo.race.RaceSettings`, as for
            :func:`~stkzoo.evaluation.demonstrations.plan_demos`.

    Raises:
        ConfigError: an argument cannot be, or other demonstrations are there.
        AssetError: the game's data is missing.
        DemosError: some races could not be recorded.
    """
    planned = plan_demos(agent, **plan)
    return record_plan(planned, output, jobs=jobs, race_timeout=race_timeout, on_race=on_race)


def record_plan(
    plan: DemoPlan,
    output: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
) -> Demonstrations:
    """Records a planned data set; see :func:`record`."""
    target = Path(output)
    if target.suffix != _ENDING:
        raise ConfigError(
            f"the data set is {str(output)!r}, expected a path that ends in {_ENDING}"
        )
    if not 0 < race_timeout < 1e9:
        raise ConfigError(f"race_timeout is {race_timeout!r}, expected seconds above 0")
    if jobs is not None:
        check_whole("jobs", jobs, 1)
    if target.exists():
        return _there(plan, target)
    folder_path = parts_folder(target)
    with BatchFolder(DEMOS, folder_path) as folder:
        plan = folder.keep_plan(plan)
        orders = [replace(o, file=str(_part(folder_path, o))) for o in plan.orders()]
        _run(orders, jobs or cpu_count(), race_timeout, on_race)
        parts = [load(order.file) for order in orders]
        demos = replace(join(parts), plan=plan.to_form())
        save(demos, target)
    shutil.rmtree(folder_path, ignore_errors=True)
    return demos


def parts_folder(output: Path) -> Path:
    """Where the races are kept meanwhile."""
    return output.with_name(output.name + ".parts")


def _there(plan: DemoPlan, target: Path) -> Demonstrations:
    """The data set that is there already, if it is the one that is asked for."""
    demos = load(target)
    differences = DemoPlan.from_form(demos.plan).differences(plan)
    if differences:
        raise ConfigError(
            f"{target} has other demonstrations: {'; '.join(differences)}. Choose another file, or "
            "delete it"
        )
    return demos


def _part(folder: Path, order: DemoOrder) -> Path:
    return folder / "races" / f"{order.number:05d}{_ENDING}"


def _run(
    orders: Sequence[DemoOrder], jobs: int, timeout: float, on_race: ProgressListener | None
) -> None:
    """Runs those whose file is not there.

    Raises:
        DemosError: some could not be run.
    """
    tell = on_race or (lambda _: None)
    left = [order for order in orders if not Path(order.file).exists()]
    done = len(orders) - len(left)
    errors: dict[int, str] = {}
    tell(BatchProgress(done, len(orders)))
    with closing(run_in_parallel(left, jobs, timeout)) as outcomes:
        for outcome in outcomes:
            last = None
            if outcome.error:
                errors[outcome.order.number] = outcome.error
            else:
                done += 1
                last = RaceResult.from_json(outcome.result)
            tell(BatchProgress(done, len(orders), last, outcome.error))
    if errors:
        raise DemosError(errors_in_words(errors, len(orders)))
