"""Reports from templates of Jinja, which are files beside the code that fills them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stkzoo._imports import import_extra


def require_jinja2() -> Any:
    """Imports ``jinja2``.

    Raises:
        ConfigError: Jinja is not installed.
    """
    return import_extra("jinja2", "the report needs", "races")


def render(file: Path, **values: Any) -> str:
    """Returns the text of a template; in HTML, all values are escaped.

    Args:
        file: the template. It can include files of its folder.
        **values: what the template names.

    Raises:
        ConfigError: Jinja is not installed.
    """
    jinja2 = require_jinja2()
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(file.parent),
        autoescape=file.suffix == ".html",
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    text: str = environment.get_template(file.name).render(**values)
    return text
