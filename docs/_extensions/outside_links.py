"""Adapts links from ``docs`` to other parts of the repository, so that they work on the site.

A link to a page that the site includes becomes a link to that page. A link to another Markdown file
becomes a link to the repository, and a link to a folder becomes plain text. MyST turns links to
other files into downloads.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from stkzoo._installation import project_url

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"

#: Files outside ``docs``, and their pages on the site.
PAGES = {
    ROOT / "README.md": DOCS / "index.md",
    ROOT / "CHANGELOG.md": DOCS / "changelog.md",
    ROOT / "CONTRIBUTING.md": DOCS / "contributing.md",
    ROOT / "benchmarks" / "README.md": DOCS / "explanation" / "benchmarks.md",
}

_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<path>\.\./[^)#\s]*)(?P<place>#[^)\s]*)?\)")


def inside(text: str, folder: Path) -> str:
    """Returns the text of a page in ``folder`` with its links out of ``docs`` adapted."""

    def replaced(link: re.Match[str]) -> str:
        path = (folder / link["path"]).resolve()
        if path in PAGES:
            return f"[{link['text']}]({os.path.relpath(PAGES[path], folder)})"
        if path.suffix == ".md" and DOCS not in path.parents:
            page = f"{project_url('Repository')}/blob/main/{path.relative_to(ROOT).as_posix()}"
            return f"[{link['text']}]({page}{link['place'] or ''})"
        return link["text"] if path.is_dir() and DOCS not in path.parents else link[0]

    return _LINK.sub(replaced, text)


def _read(_: Any, name: str, source: list[str]) -> None:
    source[0] = inside(source[0], (DOCS / name).parent)


def setup(app: Any) -> dict[str, Any]:
    """Sets up the Sphinx extension."""
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
