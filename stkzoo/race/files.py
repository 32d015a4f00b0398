"""Where the files of an agent lie: a folder, a zip, one Python file or a module's name."""

from __future__ import annotations

import importlib.util
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from stkzoo.errors import ConfigError
from stkzoo.race.unpacking import members_of, unpack
from stkzoo.scratch import ScratchFolder

__all__ = ["ACTOR_MODULE", "AgentFiles", "AgentPlace", "find_files"]

#: The module that an agent consists of.
ACTOR_MODULE = "pystk_actor"
_PACKAGE = "stk_actor"


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
        folder = life.enter_context(ScratchFolder("agent"))
        home = folder.path / self.path.stem
        unpack(self.path, home)
        return _place_in(_only_folder(home), self.source)


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
    try:
        found = importlib.util.find_spec(parts[0])
    except (ImportError, ValueError):
        found = None
    return found is not None or Path(parts[0]).is_dir() or Path(f"{parts[0]}.py").is_file()


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
