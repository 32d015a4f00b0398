"""Records demonstrations, or resumes that.

While races run they are stored in a folder beside the data set. When all are there, they are joined
into the data set, and the folder is removed.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.run import (
    RACE_TIMEOUT,
    BatchError,
    ProgressListener,
    RunOptions,
    open_batch,
)
from stkzoo.evaluation.demonstrations.dataset import (
    Demonstrations,
    join,
    load_demonstrations,
    save_demonstrations,
)
from stkzoo.evaluation.demonstrations.plan import DemoPlan, plan_demonstrations

_ENDING = ".npz"


def record_demonstrations(
    agent: str = "heuristic",
    *,
    output: str | os.PathLike[str],
    jobs: int | None = None,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **plan: Any,
) -> Demonstrations:
    """Records a driver's races as a data set, or resumes that.

    Args:
        agent: the driver; see :func:`~stkzoo.evaluation.plan_demonstrations`.
        output: the data set's file, whose name ends in ``.npz``. While races run they are stored
            in a folder beside it, ``output.parts``; the same call resumes after an interruption.
        jobs: see :class:`~stkzoo.evaluation.RunOptions`.
        race_timeout: likewise.
        on_race: likewise.
        plan: ``view``, ``tracks``, ``reverse``, ``seeds``, ``karts``, ``rivals``,
            ``substeps``, ``settings`` and fields of :class:`~stkzoo.race.RaceSettings`, as for
            :func:`~stkzoo.evaluation.plan_demonstrations`.

    Raises:
        ConfigError: an argument is invalid, or ``output`` has other demonstrations.
        AssetError: the game's data is missing.
        BatchError: some races could not be recorded.
    """
    options = RunOptions(jobs, race_timeout, on_race)
    return record_plan(plan_demonstrations(agent, **plan), output, options)


def record_plan(
    plan: DemoPlan, output: str | os.PathLike[str], options: RunOptions
) -> Demonstrations:
    """Records a planned data set; see :func:`record_demonstrations`."""
    target = Path(output)
    if target.suffix != _ENDING:
        raise ConfigError(
            f"the data set is {str(output)!r}, expected a path that ends in {_ENDING}"
        )
    if target.exists():
        return _load_same(plan, target)
    parts = target.with_name(target.name + ".parts")
    with open_batch(plan, parts) as batch:
        orders = [
            replace(order, file=str(parts / "races" / f"{order.number:05d}{_ENDING}"))
            for order in batch.plan.orders()
        ]
        results = batch.run(orders, options)
        if batch.errors:
            raise BatchError.of(batch.errors, len(orders), None)
        joined = join([results[order.number] for order in orders])
        demos = replace(joined, plan=batch.plan.to_dict())
        save_demonstrations(demos, target)
    shutil.rmtree(parts, ignore_errors=True)
    return demos


def _load_same(plan: DemoPlan, target: Path) -> Demonstrations:
    """The data set that exists already, if its plan is the same."""
    demos = load_demonstrations(target)
    if differences := DemoPlan.from_dict(demos.plan).differences(plan):
        raise ConfigError(
            f"{target} has other demonstrations: {'; '.join(differences)}. Choose another file, or "
            "delete it"
        )
    return demos
