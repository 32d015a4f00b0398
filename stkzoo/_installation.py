"""The installation of this copy of stkzoo, and the command that adds an extra to it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from shutil import which

_EXTRA = re.compile(r"extra\s*==\s*['\"]([\w-]+)['\"]")
#: What Python writes if an extension needs a library that the system does not have.
_NO_LIBRARY = re.compile(r"^ImportError: (\S+\.so\S*): cannot open shared object file", re.M)
#: Commands that install the libraries that the engine takes from the system.
_LIBRARY_COMMANDS = {
    "libglib-2.0.so.0": "Debian, Ubuntu: sudo apt install libglib2.0-0; Fedora: sudo dnf install "
    "glib2"
}


def project_url(label: str) -> str:
    """Returns an address of the project from the package's metadata; empty if unknown.

    Args:
        label: the address's label, ``"Repository"`` or ``"Documentation"``.
    """
    package = _installed()
    urls = (package and package.metadata.get_all("Project-URL")) or []
    return next((url.partition(", ")[2] for url in urls if url.startswith(f"{label}, ")), "")


def requirements() -> dict[str, list[str]]:
    """Returns the requirements of each extra, such as ``{"web": ["aiohttp>=3.11"]}``.

    Those of stkzoo itself have the key ``""``.
    """
    package = _installed()
    by_extra: dict[str, list[str]] = {"": []}
    for requirement in (package and package.requires) or ():
        extra = _EXTRA.search(requirement)
        text = requirement.partition(";")[0].strip()
        by_extra.setdefault(extra[1] if extra else "", []).append(text)
    return by_extra


def unmet_requirements(texts: Iterable[str]) -> Iterator[str]:
    """Yields what is wrong with the installed libraries, such as ``"no ray"``.

    Args:
        texts: requirements, such as ``"aiohttp>=3.11"``.
    """
    for text in texts:
        name, least = re.split(r"[^\w.-]", text)[0], text.partition(">=")[2]
        versions = [package.version for package in metadata.distributions(name=name)]
        if not versions:
            yield f"no {name}"
        elif _numbers(versions[0]) < _numbers(least):
            yield f"{name} {versions[0]} is older than {least}"


def _numbers(version: str) -> list[int]:
    """Returns the first numbers of a version, such as ``[2, 13, 0]`` for ``"2.13.0+cpu"``."""
    return [int(number) for number in re.findall(r"\d+", version)[:3]]


def install_command(extra: str) -> str:
    """Returns the command that installs the libraries of an extra of stkzoo.

    pip takes their names from the installed copy, so no package index needs to have stkzoo.

    Args:
        extra: name of the extra, such as ``"sb3"``; empty for the libraries that stkzoo requires.
    """
    return pip_install(f'"stkzoo[{extra}]"' if extra else "stkzoo")


def pip_install(arguments: str) -> str:
    """Returns the pip command that installs into the running Python.

    Args:
        arguments: arguments of ``pip install``.
    """
    pip = which("pip")
    here = Path(sys.executable).parent
    if pip and Path(pip).parent == here:
        return f"pip install {arguments}"
    return f'"{sys.executable}" -m pip install {arguments}'


def unusable(problem: str) -> BaseException:
    """Returns the error for a problem that prevents the import of stkzoo.

    It ends the command ``stkzoo`` without a traceback.

    Args:
        problem: what is wrong, and the remedy.
    """
    is_command = Path(getattr(sys, "argv", [""])[0]).name == "stkzoo"
    return SystemExit(f"stkzoo: {problem}") if is_command else ImportError(problem)


def library_remedy(output: str) -> str:
    """Returns how to install the library of the system that a program did not find.

    Args:
        output: output of the program.

    Returns:
        The remedy, one line; empty if the program found its libraries.
    """
    if not (missing := _NO_LIBRARY.search(output)):
        return ""
    command = _LIBRARY_COMMANDS.get(missing[1])
    return f"install your system's package with {missing[1]}" + (f" ({command})" if command else "")


def _installed() -> metadata.Distribution | None:
    """Returns the installed distribution.

    The one that pip installed comes first. A build also leaves metadata in a checkout, which may
    be out of date.
    """
    distributions = list(metadata.distributions(name="stkzoo"))
    by_pip = (package for package in distributions if package.read_text("INSTALLER"))
    return next(by_pip, distributions[0] if distributions else None)
