"""The process that records races, one after another; see :mod:`stkzoo.evaluation.batch.worker`."""

from __future__ import annotations

import traceback
from dataclasses import replace
from typing import Any

from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch.worker import serve
from stkzoo.evaluation.demonstrations.dataset import save
from stkzoo.evaluation.demonstrations.plan import DemoOrder
from stkzoo.evaluation.demonstrations.recorder import DemoRecorder, DemoView
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

__all__ = ["run_order"]


def run_order(order: DemoOrder) -> str:
    """Runs and records a race, and keeps its episodes in the order's file.

    Returns:
        The race's result as JSON.
    """
    plan = order.plan
    recorder = DemoRecorder(plan.karts, DemoView(plan.view), plan.substeps, order.number)
    result = run_race(
        plan.drivers,
        listeners=[recorder],
        wait_for=range(plan.karts),
        settings=_in_substeps(order.settings, plan.substeps),
    )
    episodes = recorder.episodes({"view": plan.view})
    if episodes is None:
        raise StkzooError("the race was over before its first step")
    save(episodes, order.file)
    return result.to_json()


def _in_substeps(settings: RaceSettings, substeps: int) -> RaceSettings:
    """The settings of a race whose steps are so many times shorter."""
    steps = {name: getattr(settings, name) for name in ("max_steps", "max_steps_after_first")}
    return replace(
        settings, **{name: count * substeps for name, count in steps.items() if count is not None}
    )


def _run(form: dict[str, Any]) -> dict[str, Any]:
    try:
        return {"result": run_order(DemoOrder.from_form(form))}
    except StkzooError as error:
        return {"error": str(error)}
    except Exception:  # noqa: BLE001 - told to the program, which tells the user
        return {"error": traceback.format_exc()}


if __name__ == "__main__":
    serve(_run)
