"""Keeps the modules of agents apart whose files bear the same names."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from stkzoo.race.files import AgentPlace

__all__ = ["ModuleScope"]

_INSTALLED = {"site-packages", "dist-packages"}


class ModuleScope:
    """A context in which an agent's modules are the ones that ``import`` finds.

    On entry the agent's own modules and folders take their places in ``sys.modules`` and
    ``sys.path``; on exit they leave them again, and whoever else bears the same names is
    back. May be entered within itself. ``pystk2_gymnasium`` is stkzoo's own in it
    (:mod:`stkzoo.compat`).
    """

    def __init__(self, place: AgentPlace) -> None:
        self._place = place
        self._roots = [Path(root) for root in (place.first, place.last) if root]
        self._names = frozenset(_top(name) for name in place.modules) | _siblings(place)
        self._own = _compat_modules()
        self._hidden: dict[str, ModuleType] = {}
        self._depth = self._count = 0

    def __enter__(self) -> None:
        self._depth += 1
        if self._depth > 1:
            return
        self._hidden = self._others()
        for name in self._hidden:
            del sys.modules[name]
        sys.modules.update(self._own)
        if self._place.first:
            sys.path.insert(0, self._place.first)
        if self._place.last:
            sys.path.append(self._place.last)
        self._count = len(sys.modules)

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth:
            return
        if len(sys.modules) != self._count:
            self._own.update(self._new_modules())
        for name in self._own:
            sys.modules.pop(name, None)
        sys.modules.update(self._hidden)
        for root in (self._place.first, self._place.last):
            if root in sys.path:
                sys.path.remove(root)

    def load(self) -> ModuleType:
        """Imports the agent's module; call it inside the context.

        Raises:
            ModuleNotFoundError: there is no such module.
        """
        importlib.invalidate_caches()
        if self._place.package:
            _import_package(Path(self._place.package), self._place.modules[0].partition(".")[0])
        *others, last = self._place.modules
        for name in others:
            try:
                return importlib.import_module(name)
            except ModuleNotFoundError as error:  # noqa: PERF203 - two at most
                if error.name is None or not f"{name}.".startswith(f"{error.name}."):
                    raise  # the agent's own imports fail
        return importlib.import_module(last)

    def _others(self) -> dict[str, ModuleType]:
        """Modules that bear the agent's names at the moment."""
        strange = {name for name in self._names if name in sys.modules and self._is_strange(name)}
        named = {name: sys.modules[name] for name in self._own if name in sys.modules}
        if not strange:
            return named
        loaded = list(sys.modules.items())
        return named | {name: module for name, module in loaded if _top(name) in strange}

    def _new_modules(self) -> dict[str, ModuleType]:
        return {
            name: module
            for name, module in list(sys.modules.items())
            if name not in self._own and _top(name) != "stkzoo" and self._is_own(module)
        }

    def _is_own(self, module: ModuleType) -> bool:
        path = _path_of(module)
        return path is not None and any(
            path.is_relative_to(root) and not _INSTALLED & set(path.relative_to(root).parts)
            for root in self._roots
        )

    def _is_strange(self, name: str) -> bool:
        """Whether a module is another one than the agent means by its name."""
        path = _path_of(sys.modules.get(_top(name)))
        if path is None or _INSTALLED & set(path.parts):
            return False
        return not any(path.is_relative_to(root) for root in self._roots)


def _compat_modules() -> dict[str, ModuleType]:
    """What agents find as ``pystk2_gymnasium``, whether the real one is installed or not."""
    home, name = "stkzoo.compat.", "pystk2_gymnasium"
    importlib.import_module(home + name)
    return {
        full.removeprefix(home): module
        for full, module in list(sys.modules.items())
        if full.startswith(home + name)
    }


def _path_of(module: ModuleType | None) -> Path | None:
    """Where a module's code lies; ``None`` for those that are built in."""
    file = getattr(module, "__file__", None)
    if not isinstance(file, str):
        folders = list(getattr(module, "__path__", None) or ())
        file = folders[0] if folders else None
    return Path(file) if isinstance(file, str) else None


def _top(name: str) -> str:
    return name.partition(".")[0]


def _siblings(place: AgentPlace) -> frozenset[str]:
    """Modules beside the agent's, which it may import by their bare names."""
    if not place.first or place.package:
        return frozenset()
    names = {entry.stem for entry in Path(place.first).glob("*.py")}
    names |= {entry.parent.name for entry in Path(place.first).glob("*/__init__.py")}
    return frozenset(names - set(sys.stdlib_module_names))


def _import_package(folder: Path, name: str) -> None:
    """Imports a package by its folder, which need not have a name that can be imported."""
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(
        name, folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    if spec is None or spec.loader is None:
        raise ModuleNotFoundError(f"no package in {folder}", name=name)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        sys.modules.pop(name, None)
        raise
