"""Links out of ``docs``, which lead somewhere in the repository, as links that the site has.

A file becomes a download, which MyST does by itself; a page that the site shows too, a link to it
there; a folder, which no site can show, its name.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

#: Files outside of ``docs`` that are pages of the site.
PAGES = {
    "../README.md": "index.md",
    "../CHANGELOG.md": "changelog.md",
    "../CONTRIBUTING.md": "contributing.md",
    "../benchmarks/README.md": "benchmarks-method.md",
}

_LINK = re.compile(r"\[(?P<text>[^\]]*)\]\((?P<path>\.\./[^)#\s]*)(?P<place>#[^)\s]*)?\)")


def inside(text: str, folder: Path) -> str:
    """A page's text with its links out of the site turned into ones that work."""

    def replaced(link: re.Match[str]) -> str:
        path = link["path"]
        if path in PAGES:
            return f"[{link['text']}]({PAGES[path]})"
        return link["text"] if (folder / path).is_dir() else link[0]

    return _LINK.sub(replaced, text)


def _read(app: Any, _: str, source: list[str]) -> None:
    source[0] = inside(source[0], Path(app.srcdir))


def setup(app: Any) -> dict[str, Any]:
    """Sphinx's entry point."""
    app.connect("source-read", _read)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
