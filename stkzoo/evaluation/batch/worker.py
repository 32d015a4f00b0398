"""The process that runs races of a batch, one after another.

It reads one JSON line a race from its standard input and writes one line with the outcome
to its standard output. It ends at once when its input is closed, also in the middle of a
race: so it does not outlive the program that started it, however that ends.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

from stkzoo.errors import StkzooError
from stkzoo.race.runner import run_race
from stkzoo.race.settings import RaceSettings

__all__ = ["serve"]


def _read(orders: queue.SimpleQueue[dict[str, Any]]) -> None:
    try:
        for line in sys.stdin:
            orders.put(json.loads(line))
    finally:
        os._exit(0)


def _run(order: dict[str, Any]) -> dict[str, Any]:
    drivers = order["drivers"]
    try:
        result = run_race(
            drivers,
            start_positions=range(1, len(drivers) + 1),
            wait_for=order["wait_for"],
            settings=RaceSettings(**order["settings"]),
        )
    except StkzooError as error:
        return {"error": str(error)}
    except Exception:  # noqa: BLE001 - told to the program, which tells the user
        return {"error": traceback.format_exc()}
    return {"result": result.to_json()}


def serve(run: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    """Answers orders until the input is closed.

    Args:
        run: runs a race; its answer has ``result``, which is JSON, or ``error``.
    """
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what agents print goes elsewhere
    orders: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(orders,), daemon=True).start()
    while True:
        answers.write(json.dumps(run(orders.get())) + "\n")
        answers.flush()


if __name__ == "__main__":
    serve(_run)
