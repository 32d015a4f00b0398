"""Commands that run code in a new Python interpreter."""

from __future__ import annotations

import os
import sys

#: Python before 3.11 lacks the option ``-P``. ``sys`` is built in, so no file can replace it.
_OPTIONS = ("-P",) if sys.version_info >= (3, 11) else ()
_BEGINNING = "import sys; sys.path[:] = filter(None, sys.path)\n"


def python_command(code: str, *arguments: str) -> list[str]:
    """Returns a command that runs code in a new interpreter.

    ``python -c`` and ``python -m`` search the current folder first. If that folder belongs to an
    agent, a file such as ``json.py`` in it would run outside the agent's sandbox. So the current
    folder is not on the new interpreter's search path.

    Args:
        code: the code.
        *arguments: the rest of its ``sys.argv``.
    """
    return [sys.executable, *_OPTIONS, "-c", _BEGINNING + code, *arguments]


def search_path(*, has_current: bool = True) -> list[str]:
    """Returns this program's module search path, for a process that must find the same modules.

    In an interactive session, an empty entry means the current folder; it is replaced by its path.
    Entries that are not strings, which Python ignores, are left out.

    Args:
        has_current: whether to include the current folder of an interactive session.
    """
    texts = (path for path in sys.path if isinstance(path, str))
    return [path or os.getcwd() for path in texts if path or has_current]
