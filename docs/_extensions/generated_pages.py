"""Builds the pages that are written from code and results; git ignores them.

To build them without the site, run ``python docs/_extensions/generated_pages.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import command_page
import gallery_page
import result_page
import suite_page
import view_pages

DOCS = Path(__file__).parents[1]
_MODULES = (command_page, gallery_page, result_page, suite_page, view_pages)


def pages() -> dict[str, str]:
    """Returns the text of each page, by its path in ``docs``."""
    return {path: text for module in _MODULES for path, text in module.pages().items()}


def write() -> None:
    """Writes the pages. Those that have not changed keep their time, so Sphinx skips them."""
    for path, text in pages().items():
        file = DOCS / path
        if not file.exists() or file.read_text("utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, "utf-8")


def setup(app: Any) -> dict[str, Any]:
    """Sets up the Sphinx extension."""
    app.connect("builder-inited", lambda _: write())
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write()
