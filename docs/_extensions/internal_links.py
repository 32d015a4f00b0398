"""Warns about broken internal links in the built site."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """Anchors and link targets of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.targets: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if value is None:
                continue
            if name == "id" or (tag == "a" and name == "name"):
                self.names.add(value)
            elif name in ("href", "src", "poster"):
                self.targets.add(value)


def broken_links(site: Path) -> list[str]:
    """Returns a line for each broken internal link of a site."""
    pages = {path: _Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        for target in sorted(page.targets):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue  # an external link
            to = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            to = to / "index.html" if to.is_dir() else to
            if not to.exists():
                found.append(f"{path.relative_to(site)}: {target}: no such file")
            elif parts.fragment and to in pages and not _has(pages[to], parts.fragment):
                found.append(f"{path.relative_to(site)}: {target}: no such place on the page")
    return found


def _has(page: _Page, fragment: str) -> bool:
    return unquote(fragment) in page.names or fragment in page.names


def _check(app: Any, exception: Exception | None) -> None:
    from sphinx.util import logging  # the rest of this file works without Sphinx

    logger = logging.getLogger(__name__)
    if exception is None and app.builder.name == "html":
        for line in broken_links(Path(app.outdir).resolve()):
            logger.warning("broken link: %s", line)


def setup(app: Any) -> dict[str, Any]:
    """Sets up the Sphinx extension."""
    app.connect("build-finished", _check, priority=900)  # after all other handlers
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
