"""A web page that shows a race live in the browser.

>>> from stkzoo.race import run_race
>>> from stkzoo.race.web import LivePage
>>> page = LivePage(port=0, speed=None)
>>> page.url.startswith("http://127.0.0.1:")
True
>>> result = run_race(["heuristic", "ai"], listeners=[page], track="lighthouse", max_steps=5)
"""

from __future__ import annotations

from stkzoo.race.web.control import SPEEDS
from stkzoo.race.web.page import LivePage

__all__ = ["SPEEDS", "LivePage"]
__dir__ = __all__.copy
