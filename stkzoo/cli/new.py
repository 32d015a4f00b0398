"""Create a starter agent.

Writes a small commented driver to a new folder, as a starting point for your own, and a README.md
with the next steps. The driver finishes a lap of each training track. With a view other than
simple, its actions are random until you add a policy. Existing files are never overwritten.

Examples:
  stkzoo new my_agent                create my_agent/pystk_actor.py
  stkzoo new my_agent --view racing  for a policy that you train on this view
  stkzoo race my_agent ai ai         race it against the game's AI
  stkzoo check my_agent              see whether a tournament would accept it
"""

from __future__ import annotations

import json
import os
import shlex
from dataclasses import dataclass
from pathlib import Path
from string import Template

from stkzoo._arguments import option, positional
from stkzoo._installation import project_url
from stkzoo._os import write_text
from stkzoo._schema import plain_text
from stkzoo.drivers.driver import driver_names, find_driver_view
from stkzoo.errors import ConfigError

#: Files of agents, with the placeholders of :class:`string.Template`.
_TEMPLATES = Path(__file__).with_name("templates")


@dataclass
class NewArguments:
    """Arguments of ``stkzoo new``.

    Attributes:
        folder: folder to create
        view: view of the agent, such as simple, racing or box_continuous
    """

    folder: str = positional(metavar="FOLDER")
    view: str = option("simple", metavar="NAME")


def run(arguments: NewArguments) -> None:
    """Creates the agent and prints what to do next."""
    find_driver_view(arguments.view)
    _check_name(arguments.folder)
    folder = make_empty(arguments.folder)
    name = os.path.basename(os.path.realpath(folder))
    quoted, archive = shlex.quote(arguments.folder), shlex.quote(f"{name}.zip")
    write_agent(folder, name, arguments.view)
    fill("README.md", folder / "README.md", name=name, folder=quoted, zip=archive)
    print(f"Created {folder / 'pystk_actor.py'} and README.md. Next:")
    for command, purpose in (
        (f"stkzoo race {quoted} ai ai", "race it against the game's AI"),
        (f"stkzoo check {quoted}", "see what a tournament would say"),
        (f"python -m zipfile -c {archive} {quoted}", "make the zip to hand in"),
    ):
        print(f"  {command}\n      {purpose}")


def make_empty(path: str) -> Path:
    """Creates a folder, which may exist if it is empty, and returns it.

    Args:
        path: the folder.

    Raises:
        ConfigError: it cannot be created, or is not empty.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise ConfigError(f"cannot create {path!r}: {error.strerror}") from None
    if not is_empty:
        raise ConfigError(f"{path!r} is not empty; choose another folder")
    return folder


def write_agent(folder: Path, name: str, view: str = "simple") -> None:
    """Writes the code of a starter agent.

    Args:
        folder: folder of the agent.
        name: name of the agent.
        view: view of the agent.
    """
    actor = "simple" if view == "simple" else "policy"
    text = json.dumps(name, ensure_ascii=False)
    fill(f"{actor}.py", folder / "pystk_actor.py", name=text, view=view)


def fill(template: str, file: Path, **values: str) -> None:
    """Writes a file from a template.

    Args:
        template: name of the template, without its suffix.
        file: the file.
        **values: values of the template's placeholders.
    """
    text = (_TEMPLATES / f"{template}-tpl").read_text("utf-8")
    write_text(file, Template(text).substitute(values, url=project_url("Documentation")))


def _check_name(folder: str) -> None:
    """Refuses a folder that files cannot name, or that commands would not accept as an agent."""
    path = os.path.realpath(folder)
    is_driver = folder in driver_names() or folder.startswith(("ai:", "pretrained:"))
    if plain_text(path) != path or "@:" in folder or is_driver:
        raise ConfigError(
            f"{plain_text(folder)!r} is the name of a driver of stkzoo, or contains @:, control "
            "codes or letters that this locale cannot read; choose another folder"
        )
