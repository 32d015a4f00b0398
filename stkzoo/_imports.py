"""Imports: lazy names, libraries of extras, and the search path of new interpreters."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Collection, Mapping
from types import MappingProxyType
from typing import Any

from stkzoo.errors import ConfigError

#: Python before 3.11 lacks the option ``-P``. ``sys`` is built in, so no file can replace it.
_OPTIONS = ("-P",) if sys.version_info >= (3, 11) else ()
_BEGINNING = "import sys; sys.path[:] = filter(None, sys.path)\n"


def lazy_names(
    package: str, homes: Mapping[str, Collection[str]] = MappingProxyType({})
) -> Callable[[str], Any]:
    """Returns a ``__getattr__`` function that imports names and submodules when they are used.

    Args:
        package: ``__name__`` of the package.
        homes: the names that each module defines.
    """
    modules = {name: module for module, names in homes.items() for name in names}

    def find(name: str) -> Any:
        if name in modules:
            return getattr(importlib.import_module(modules[name]), name)
        if not name.startswith("_") and importlib.util.find_spec(f"{package}.{name}"):
            return importlib.import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return find


def import_extra(module: str, needs: str, extra: str, hint: str = "") -> Any:
    """Imports a module of a library that one of stkzoo's extras installs.

    Args:
        module: name of the module.
        needs: subject and verb of the error text, such as ``"the plot needs"``.
        extra: name of the extra.
        hint: end of the error text, after the command that installs the extra, such as
            ``"or pass --no-plot"``.

    Raises:
        ConfigError: the library is not installed or cannot be loaded.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        from stkzoo._installation import install_command

        package = module.partition(".")[0]
        library = {"PIL": "Pillow"}.get(package, package)
        is_missing = isinstance(error, ModuleNotFoundError) and package in str(error.name)
        problem = "is not installed" if is_missing else f"does not load ({error})"
        remedy = f"{install_command(extra)} {hint}".rstrip()
        library = f"{library} (extra {extra})"
        raise ConfigError(f"{needs} {library}, which {problem}: {remedy}") from error


def python_command(code: str, *arguments: str) -> list[str]:
    """Returns a command that runs code in a new interpreter.

    ``python -c`` and ``python -m`` search the current folder first. If that folder belongs to an
    agent, a file such as ``json.py`` in it would run outside the agent's sandbox. So the current
    folder is not on the new interpreter's search path.

    Args:
        code: the code.
        *arguments: the rest of its ``sys.argv``.
    """
    return [python_executable(), *_OPTIONS, "-c", _BEGINNING + code, *arguments]


def python_executable() -> str:
    """Returns the path of this interpreter, without ``..``, which a sandbox may not contain."""
    return os.path.abspath(sys.executable)


def search_path(*, has_current: bool = True) -> list[str]:
    """Returns this program's module search path, for a process that must find the same modules.

    Relative entries, such as the empty one in an interactive session, are replaced by their paths.
    Entries that are not strings, which Python ignores, are left out.

    Args:
        has_current: whether to include the current folder of an interactive session.
    """
    texts = (path for path in sys.path if isinstance(path, str))
    return [os.path.abspath(path) for path in texts if path or has_current]
