"""The process that runs races of a batch, one after another.

It reads one JSON line per race from standard input and writes one line with the outcome to
standard output. It exits as soon as its input is closed, even during a race, so it never outlives
the program that started it.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
import traceback
from importlib import import_module
from pathlib import Path
from typing import Any

from stkzoo.errors import StkzooError
from stkzoo.race.document import typed


def serve() -> None:
    """Runs orders until the input is closed."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # agents' prints must not mix with the answers
    lines: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    while True:
        answers.write(json.dumps(_run(lines.get())) + "\n")
        answers.flush()


def _read(lines: queue.SimpleQueue[dict[str, Any]]) -> None:
    try:
        for line in sys.stdin:
            lines.put(json.loads(line))
    finally:
        os._exit(0)


def _run(line: dict[str, Any]) -> dict[str, str]:
    try:
        kind = getattr(import_module(line["module"]), line["class"])
        return {"result": typed(kind, line["order"]).run(Path(line["folder"])).to_json()}
    except StkzooError as error:
        return {"error": str(error)}
    except Exception:  # noqa: BLE001 - the program reports it to the user
        return {"error": traceback.format_exc()}


if __name__ == "__main__":
    serve()
