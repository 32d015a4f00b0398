"""The files of an agent: a folder, a zip, one Python file or the name of a module."""

from __future__ import annotations

import importlib.util
import re
import stat
import zipfile
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path, PurePosixPath

from stkzoo._os import LockedTemporaryDirectory
from stkzoo.errors import ConfigError

__all__ = [
    "ACTOR_MODULE",
    "MAX_BYTES",
    "MAX_FILES",
    "MAX_RATIO",
    "AgentFiles",
    "AgentPlace",
    "declared_env",
    "find_files",
    "members_of",
    "unpack",
]

#: The module that an agent consists of.
ACTOR_MODULE = "pystk_actor"
_PACKAGE = "stk_actor"
#: How a module names its environment in so many words.
_ENV_NAME = re.compile(r"""^env_name\s*(?::\s*\w+\s*)?=\s*["']([^"'\n]+)["']""", re.MULTILINE)
#: Nothing is looked for beyond so many characters of a module.
_LONGEST = 1 << 20

#: An agent with its weights takes up no more than this ...
MAX_BYTES = 1 << 30
#: ... in no more files than this ...
MAX_FILES = 10_000
#: ... and what is larger than a megabyte does not shrink by more than this when zipped.
MAX_RATIO = 200
_SMALL = 1 << 20
_BLOCK = 1 << 16


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


def members_of(path: Path) -> list[str]:
    """Names of the files in a zip.

    Raises:
        ConfigError: it is no zip, or one that :func:`unpack` refuses.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return [member.filename for member in _checked(archive, path)]
    except (ConfigError, MemoryError):
        raise
    except Exception as error:  # zipfile and zlib tell of damage in many ways
        raise _damaged(path, error) from error


def unpack(path: Path, folder: Path) -> None:
    """Unpacks a zip into a new folder.

    Everything in it becomes a plain file or folder, readable by its owner alone.

    Raises:
        ConfigError: the zip is damaged, encrypted, too large, or holds links or paths that
            lead out of it; the folder may hold a part of it then.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            budget = MAX_BYTES
            folder.mkdir(parents=True)
            for member in _checked(archive, path):
                budget -= _write(archive, member, folder / member.filename, budget, path)
    except (ConfigError, MemoryError):
        raise
    except Exception as error:  # zipfile and zlib tell of damage in many ways
        raise _damaged(path, error) from error


def _checked(archive: zipfile.ZipFile, path: Path) -> list[zipfile.ZipInfo]:
    """The zip's files, if there is nothing wrong with its list of them."""
    members = archive.infolist()
    if len(members) > MAX_FILES:
        raise _refused(path, f"it holds {len(members)} files, at most {MAX_FILES} may be")
    if sum(member.file_size for member in members) > MAX_BYTES:
        raise _refused(path, f"unpacked it is larger than {MAX_BYTES >> 20} MB")
    for member in members:
        _check(member, path)
    return [member for member in members if not member.is_dir()]


def _check(member: zipfile.ZipInfo, path: Path) -> None:
    name = PurePosixPath(member.filename)
    outside = name.is_absolute() or ".." in name.parts or "\\" in member.filename
    if outside or not name.parts or ":" in name.parts[0]:
        raise _refused(path, f"{member.filename!r} leads out of it")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise _refused(path, f"{member.filename!r} is a link or a device, not a file")
    if member.flag_bits & 1:
        raise _refused(path, f"{member.filename!r} is encrypted")
    if member.file_size > max(_SMALL, MAX_RATIO * member.compress_size):
        raise _refused(path, f"{member.filename!r} would grow to {member.file_size} bytes")


def _write(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, budget: int, path: Path
) -> int:
    """Writes one file and returns its size, whatever the zip says it is."""
    target.parent.mkdir(parents=True, exist_ok=True)
    size = 0
    with archive.open(member) as source, target.open("xb") as file:
        while block := source.read(_BLOCK):
            size += len(block)
            if size > budget:
                raise _refused(path, f"unpacked it is larger than {MAX_BYTES >> 20} MB")
            file.write(block)
    target.chmod(stat.S_IRUSR | stat.S_IWUSR)
    return size


def _refused(path: Path, why: str) -> ConfigError:
    return ConfigError(f"agent {str(path)!r} is not unpacked: {why}. Zip plain files only.")


def _damaged(path: Path, error: BaseException) -> ConfigError:
    if isinstance(error, OSError):
        return ConfigError(f"agent {str(path)!r} cannot be unpacked: {error}")
    return ConfigError(f"agent {str(path)!r} is no zip that can be read: {error}")
