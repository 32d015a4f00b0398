"""Agent files: a folder, a zip, one Python file or an importable module."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import sys
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.machinery import ModuleSpec
from pathlib import Path, PurePath, PurePosixPath

from stkzoo._reading import Unreadable, open_zip, reading
from stkzoo._schema import plain_text
from stkzoo._temporary import TemporaryFolder
from stkzoo.errors import ConfigError

#: Name of the module that contains an agent.
ACTOR_MODULE = "pystk_actor"
_PACKAGE = "stk_actor"
#: Names of folders with installed packages.
INSTALLED = {"site-packages", "dist-packages"}
#: Packages that an agent imports even where they are not installed.
_PROVIDED = {"stkzoo", "pystk2_gymnasium"}
#: Pattern of an assignment to a name in a module; a literal of a few lines follows it.
_ASSIGNMENT = r"^{name}\s*(?::[^=\n]+)?=(?!=)"
_MAX_LINES, _MAX_LITERAL = 20, 2000
#: Number of characters at the beginning of a module that are searched for assignments.
_MAX_CHARACTERS = 1 << 20

#: Maximum size of an agent's unpacked files, including weights [bytes].
MAX_BYTES = 512 << 20
#: Maximum numbers of files and folders of an agent in a zip, and of folders in each other. Within
#: these limits, a processor core unpacks and removes the files in two seconds.
MAX_FILES, MAX_FOLDERS, MAX_DEPTH = 4000, 500, 16
#: Maximum length of the name of a file [bytes], which most file systems have.
_MAX_NAME = 255
#: Entries that macOS adds to zips.
_OF_MACOS = ("__MACOSX", ".DS_Store")


@dataclass(frozen=True, slots=True)
class AgentPlace:
    """How an agent's module is imported.

    Attributes:
        modules: module names to try in this order; the first that exists is imported.
        first: folder to add at the beginning of the module search path; empty for none.
        last: folder to add at the end of the module search path; empty for none.
        package: folder of the module's package; empty for none.
        paths: folders and files of the agent.
    """

    modules: tuple[str, ...]
    first: str = ""
    last: str = ""
    package: str = ""
    paths: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AgentFiles:
    """The files of an agent.

    Attributes:
        source: text from which the user selected the agent.
        path: the folder, zip or file; ``None`` for a module that Python finds by name.
    """

    source: str
    path: Path | None

    def place(self, resources: ExitStack) -> AgentPlace:
        """Returns how to import the agent, and unpacks a zip.

        Args:
            resources: closing it removes the unpacked files.

        Raises:
            ConfigError: the folder or zip contains no agent, or the zip cannot be unpacked.
        """
        if self.path is None:
            module, paths = self.source, tuple(module_paths(self.source))
            names = (f"{module}.{ACTOR_MODULE}", module)
            return AgentPlace(names, last=str(Path.cwd()), paths=paths)
        if self.path.is_dir():
            return replace(_place_in(self.path, self.source), paths=(str(self.path),))
        if self.path.suffix == ".py":
            folder = self.path.parent
            files = folder if self.path.stem == ACTOR_MODULE else self.path
            return AgentPlace((self.path.stem,), first=str(folder), paths=(str(files),))
        home = resources.enter_context(TemporaryFolder("agent")).path / self.path.stem
        unpack(self.path, home)
        return replace(_place_in_zip(home, self.source), paths=(str(home),))


def declared(files: AgentFiles, name: str) -> object:
    """Returns the literal that an agent's module assigns to a name; empty if there is none.

    The module does not run. The assignment must start at the beginning of a line, such as
    ``env_name = ``, and its value must be a literal.

    Args:
        files: the agent's files.
        name: ``env_name`` or ``player_name``.
    """
    try:
        with ExitStack() as resources:
            module = _module_file(files.place(resources))
            stream = resources.enter_context(module.open(errors="replace"))
            text = stream.read(_MAX_CHARACTERS)
    except (ConfigError, OSError):
        return ""  # reported when the agent is loaded
    assignment = re.search(_ASSIGNMENT.format(name=name), text, re.MULTILINE)
    return _literal(text[assignment.end() :][:_MAX_LITERAL]) if assignment else ""


def _literal(text: str) -> object:
    """Returns the literal at the beginning of a text; an empty string if there is none."""
    lines = text.splitlines()[:_MAX_LINES]
    for count in range(1, len(lines) + 1):
        with suppress(ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
            return ast.literal_eval("\n".join(lines[:count]).strip())
    return ""


def _module_file(place: AgentPlace) -> Path:
    """Returns the file of an agent's module, in Python's search order.

    Raises:
        FileNotFoundError: no module exists.
    """
    for name in place.modules:
        top, *rest = name.split(".")
        home = place.package or (place.first and os.path.join(place.first, top))
        homes = [home] if home else [path.removesuffix(".py") for path in place.paths]
        for module in (Path(home, *rest) for home in homes):
            for file in (module / "__init__.py", module.with_name(f"{module.name}.py")):
                if file.is_file():
                    return file
    raise FileNotFoundError(place.modules)


def installed_module(top: str) -> ModuleSpec | None:
    """Returns the spec of a top-level module without running it; ``None`` if there is none."""
    try:
        return importlib.util.find_spec(top)
    except (ImportError, OSError, ValueError):
        return None


def module_paths(name: str) -> list[str]:
    """Returns the folders and files of a module or package without running it."""
    top = name.partition(".")[0]
    spec = installed_module(top)
    places = [*(spec.submodule_search_locations or [spec.origin or ""])] if spec else []
    return [os.path.abspath(path) for path in (*places, top, f"{top}.py") if os.path.exists(path)]


def is_zip(path: PurePath) -> bool:
    """Returns whether a path is named like a zip."""
    return path.suffix.lower() == ".zip"


def name_of_files(source: str) -> str:
    """Returns the name of an agent's folder, or of its zip or file without the suffix."""
    path = PurePath(source)
    return path.stem if is_zip(path) or path.suffix == ".py" else path.name


def find_files(source: str) -> AgentFiles | None:
    """Returns the files of an agent; ``None`` if the source is neither a path nor a module.

    Args:
        source: path of a folder, zip or Python file, or name of a module. The code does not run, so
            its errors appear only when it is loaded.

    Raises:
        ConfigError: the source is an existing path, but not an agent.
    """
    path = Path(os.path.expanduser(source))
    if os.path.exists(path):
        path = path.resolve()
        shown = plain_text(str(path))
        if shown != str(path):
            raise ConfigError(
                f"the path {shown!r} of an agent has control codes or letters that this locale "
                "cannot read; rename it, or set PYTHONUTF8=1"
            )
        if path.is_dir():
            _place_in(path, source)
        elif is_zip(path):
            with _opened(path) as archive:
                names = {PurePosixPath(member.filename).name for member in _checked(archive)}
            if not names & {f"{ACTOR_MODULE}.py", "__init__.py"}:
                raise ConfigError(
                    f"agent {source!r} has no {ACTOR_MODULE}.py in it; zip the folder that has one"
                )
        elif path.suffix != ".py":
            raise ConfigError(
                f"agent {source!r} is another kind of file; expected a folder, a .zip, or a .py "
                "file"
            )
        return AgentFiles(source, path)
    return AgentFiles(source, None) if _is_module(source) else None


def _is_module(name: str) -> bool:
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts):
        return False
    is_here = os.path.exists(parts[0]) or os.path.exists(f"{parts[0]}.py")
    return is_here or installed_module(parts[0]) is not None


def _place_in(folder: Path, source: str) -> AgentPlace:
    """Finds the agent in a folder: a module or a package, in the folder or in ``stk_actor``.

    Raises:
        ConfigError: the folder contains no agent.
    """
    for home in (folder / _PACKAGE, folder):
        if (home / f"{ACTOR_MODULE}.py").is_file():
            if (home / "__init__.py").is_file():
                return _package(home, f".{ACTOR_MODULE}")
            return AgentPlace((ACTOR_MODULE,), first=str(home))
    if (folder / "__init__.py").is_file():
        return _package(folder, "")
    raise ConfigError(
        f"agent {source!r} has no {ACTOR_MODULE}.py; expected one in the folder itself or in "
        f"its folder {_PACKAGE}"
    )


def _place_in_zip(home: Path, source: str) -> AgentPlace:
    """Finds the agent in the unpacked files of a zip.

    Raises:
        ConfigError: the zip contains no agent, or contains it in an inner folder.
    """
    try:
        return _place_in(_only_folder(home), source)
    except ConfigError:
        inner = sorted(file.parent for file in home.rglob(f"{ACTOR_MODULE}.py"))
        if not inner:
            raise
        folder = inner[0].relative_to(home).as_posix()
        raise ConfigError(
            f"agent {source!r} has its {ACTOR_MODULE}.py in the inner folder {folder!r}; zip that "
            "folder alone"
        ) from None


def _package(folder: Path, module: str) -> AgentPlace:
    name, first = folder.name.replace(".", "_"), str(folder.parent)
    if _is_library(name):  # neither hides the other
        name, first = f"agent_{name}", ""
    return AgentPlace((name + module,), first=first, last=str(folder), package=str(folder))


def _is_library(name: str) -> bool:
    """Returns whether a top-level module comes with Python or stkzoo, or is installed."""
    if name in sys.stdlib_module_names or name in _PROVIDED:
        return True
    return any(INSTALLED & {*Path(path).parts} for path in module_paths(name))


def _only_folder(folder: Path) -> Path:
    """Returns the only subfolder of a folder if it contains all files; otherwise the folder."""
    entries = [entry for entry in folder.iterdir() if entry.name not in _OF_MACOS]
    is_nested = len(entries) == 1 and entries[0].is_dir() and entries[0].name != _PACKAGE
    return entries[0] if is_nested else folder


def unpack(path: Path, folder: Path) -> None:
    """Unpacks a zip into a new folder.

    Only plain files and folders are created: :mod:`zipfile` writes links and devices as files.

    Raises:
        ConfigError: the zip is damaged, encrypted or too large, or contains paths outside of it.
            The folder may then contain some of the files.
    """
    with _opened(path) as archive:
        archive.extractall(folder, _checked(archive))  # at most the listed sizes


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Opens a zip and converts all reading errors to :class:`ConfigError`."""
    what = f"agent {str(path)!r} is not a readable zip"
    with reading(what, "a zip of plain files"), open_zip(path, MAX_FILES, MAX_BYTES) as archive:
        yield archive


def _checked(archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """Checks the zip's files and returns them."""
    members = [member for member in archive.infolist() if not member.is_dir()]
    for member in members:
        _check(member)
    folders = {folder for member in members for folder in PurePosixPath(member.filename).parents}
    if len(folders) > MAX_FOLDERS:
        raise Unreadable(f"it has more than {MAX_FOLDERS} folders")
    return members


def _check(member: zipfile.ZipInfo) -> None:
    if "\\" in member.filename:  # some programs for Windows write such zips
        raise Unreadable(
            f"{member.filename!r} has backslashes between folders, expected slashes, as "
            "`python -m zipfile -c` writes them"
        )
    name = PurePosixPath(member.filename)
    if name.is_absolute() or ".." in name.parts or not name.parts:
        raise Unreadable(f"{member.filename!r} leads out of it")
    if len(name.parts) > MAX_DEPTH or max(len(part.encode()) for part in name.parts) > _MAX_NAME:
        raise Unreadable(f"{member.filename[:60]!r}... is in too many folders or has a long name")
