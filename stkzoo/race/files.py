"""Where the files of an agent lie: a folder, a zip, one Python file or a module's name."""

from __future__ import annotations

import importlib.util
import re
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path

from stkzoo._os import LockedTemporaryDirectory
from stkzoo.errors import ConfigError
from stkzoo.race.unpacking import members_of, unpack

__all__ = ["ACTOR_MODULE", "AgentFiles", "AgentPlace", "declared_env", "find_files"]

#: The module that an agent consists of.
ACTOR_MODULE = "pystk_actor"
_PACKAGE = "stk_actor"
#: How a module names its environment in so many words.
_ENV_NAME = re.compile(r"""^env_name\s*(?::\s*\w+\s*)?=\s*["']([^"'\n]+)["']""", re.MULTILINE)
#: Nothing is looked for beyond so many characters of a module.
_LONGEST = 1 << 20


@dataclass(frozen=True, slots=True)
class AgentPlace:
    """How an agent's module is imported.

    Attributes:
        modules: names to try in turn; the next one if there is no such module.
        first: folder that is searched before all others; empty for none.
        last: folder that is searched after all others; empty for none.
        package: folder of the package that the module belongs to; empty for none.
    """

    modules: tuple[str, ...]
    first: str = ""
    last: str = ""
    package: str = ""


@dataclass(frozen=True, slots=True)
class AgentFiles:
    """Files of an agent, as they were named and found.

    Attributes:
        source: as the user wrote it.
        path: the folder, zip or file; ``None`` for a module that Python finds by its name.
    """

    source: str
    path: Path | None

    @property
    def name(self) -> str:
        """What to call an agent that has no name of its own."""
        return self.source if self.path is None else self.path.stem

    def place(self, life: ExitStack) -> AgentPlace:
        """How to import the agent; a zip is unpacked for as long as ``life`` lasts.

        Raises:
            ConfigError: there is no agent, or the zip cannot be unpacked.
        """
        if self.path is None:
            module = self.source
            return AgentPlace((f"{module}.{ACTOR_MODULE}", module), last=str(Path.cwd()))
        if self.path.is_dir():
            return _place_in(self.path, self.source)
        if self.path.suffix == ".py":
            return AgentPlace((self.path.stem,), first=str(self.path.parent))
        folder = life.enter_context(LockedTemporaryDirectory("agent"))
        home = folder.path / self.path.stem
        unpack(self.path, home)
        return _place_in(_only_folder(home), self.source)


def declared_env(files: AgentFiles) -> str:
    """The environment's id that an agent's module names; empty if it does not in so many words.

    Nothing of the module is run: ``env_name = "..."`` has to begin a line of it.
    """
    try:
        with ExitStack() as life, _module_file(files.place(life)).open(errors="replace") as module:
            found = _ENV_NAME.search(module.read(_LONGEST))
    except (ConfigError, OSError):
        return ""  # told when the agent is loaded
    return found[1] if found else ""


def _module_file(place: AgentPlace) -> Path:
    """Where an agent's module is, as Python would find it.

    Raises:
        FileNotFoundError: nowhere.
    """
    for name in place.modules:
        top, *rest = name.split(".")
        for home in _homes(top, place):
            module = home.joinpath(*rest)
            for file in (module / "__init__.py", module.with_name(f"{module.name}.py")):
                if file.is_file():
                    return file
    raise FileNotFoundError(place.modules)


def _homes(top: str, place: AgentPlace) -> list[Path]:
    """Where a package may be, or a module but for its ending."""
    if place.package:
        return [Path(place.package)]
    first, last = ([Path(folder) / top] if folder else [] for folder in (place.first, place.last))
    spec = _installed(top)
    folders = list(spec.submodule_search_locations or []) if spec else []
    alone = [Path(spec.origin).with_suffix("")] if spec and spec.origin and not folders else []
    return [*first, *map(Path, folders), *alone, *last]


def _installed(top: str) -> ModuleSpec | None:
    """What Python has under a name without dots; nothing of it is run."""
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None


def find_files(source: str) -> AgentFiles | None:
    """The files of a source; ``None`` if it is neither a path nor a module.

    Args:
        source: path of a folder, zip or Python file, or name of a module. Nothing of it is
            run, so that its own mistakes show only when it is loaded.

    Raises:
        ConfigError: it is a path, but no agent.
    """
    path = Path(source).expanduser()
    if path.exists():
        path = path.resolve()
        if path.is_dir():
            _place_in(path, source)
        elif path.suffix == ".zip":
            _require_actor(members_of(path), source)
        elif path.suffix != ".py":
            raise ConfigError(
                f"agent {source!r} is a file of another kind; expected a folder, a .zip, or a "
                ".py file"
            )
        return AgentFiles(source, path)
    return AgentFiles(source, None) if _is_module(source) else None


def _is_module(name: str) -> bool:
    parts = name.split(".")
    if not all(part.isidentifier() for part in parts):
        return False
    return (
        _installed(parts[0]) is not None
        or Path(parts[0]).is_dir()
        or Path(f"{parts[0]}.py").is_file()
    )


def _place_in(folder: Path, source: str) -> AgentPlace:
    """The agent in a folder, as a plain module or a package, directly or in ``stk_actor``."""
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


def _package(folder: Path, module: str) -> AgentPlace:
    name = folder.name.replace(".", "_")
    return AgentPlace(
        (name + module,), first=str(folder.parent), last=str(folder), package=str(folder)
    )


def _only_folder(folder: Path) -> Path:
    """The folder itself, or the one folder that all of it is in."""
    entries = [entry for entry in folder.iterdir() if entry.name != "__MACOSX"]
    is_nested = len(entries) == 1 and entries[0].is_dir() and entries[0].name != _PACKAGE
    return entries[0] if is_nested else folder


def _require_actor(members: list[str], source: str) -> None:
    endings = (f"{ACTOR_MODULE}.py", "__init__.py")
    if not any(name.rsplit("/", 1)[-1] in endings for name in members):
        raise ConfigError(
            f"agent {source!r} has no {ACTOR_MODULE}.py in it; zip the folder that has one"
        )
