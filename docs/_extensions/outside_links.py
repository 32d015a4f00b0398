"""Links out of ``docs``, which lead somewhere in the repository, as links that the site has.

A file becomes a download, which MyST does by itself; a page that the site shows too, a link to it
there; a folder, which no site can show, its name.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"

#: Files outside of ``docs`` that are pages of the site.
PAGES = {
    ROOT / "README.md": DOCS / "index.md",
    ROOT / "CHANGELOG.md": DOCS / "changelog.md",
    ROOT / "CONTRIBUTING.md": DOCS / "contributing.md",
    ROOT / "benchmarks" / "README.md": DOCS / "explanation" / "benchmarks.md",
}

_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<path>\.\./[^)#\s]*)(?P<place>#[^)\s]*)?\)")


def inside(text: str, folder: Path) -> str:
    """The text of a page in ``folder``, with links out of ``docs`` replaced by ones that work."""

    def replaced(link: re.Match[str]) -> str:
        path = (folder / link["path"]).resolve()
        if path in PAGES:
            return f"[{link['text']}]({os.path.relpath(PAGES[path], folder)})"
        return link["text"] if path.is_dir() and DOCS not in path.parents else link[0]

    return _LINK.sub(replaced, text)


def _read(_: Any, name: str, source: list[str]) -> None:
    source[0] = inside(source[0], (DOCS / name).parent)


def setup(app: Any) -> dict[str, Any]:
    """Sphinx's entry point."""
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
