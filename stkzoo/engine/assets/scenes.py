"""Thins scenes: without what is only seen or heard, a step of a race takes less time.

The game updates every object of a scene in every physics step. Lights, sounds, billboards and
ghost objects, which have no collision shape, cannot touch a kart. Still, a race without them is
another race, because loading them draws random numbers. The game's bots draw from the same
generators afterwards:

- each further level of detail of an object calls C's ``rand``, from which bots choose their paths;
- each object with a random hue draws from the race's own generator, from which bots choose items.

So a thinned scene draws the same numbers without the objects:

- one object with many levels of detail makes all calls of ``rand``;
- an object with a random hue becomes one that draws its hue and then fails to load, because its
  levels of detail do not exist.

A library object can have many instances in a scene. If it has no collision shape, the first
instance stays, because it loads materials, and the others go. If it consists of fixed objects, they
replace all upright instances but the first, which saves one object for each. Objects that scripts
refer to stay, and so do library objects with a script.
"""

from __future__ import annotations

import copy
import itertools
import os
import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.engine.assets.mesh import read_textures
from stkzoo.engine.assets.tree import is_true, parse_xml
from stkzoo.errors import AssetError

# A change of the rules in this module needs another ``_LAYOUT`` in ``tree.py``.

_WITHOUT_BODY = ("ghost", "none")
#: Elements that are only seen.
_SEEN = ("light", "particle-emitter")
#: Kinds of objects that are never models.
_NO_MODEL = ("action-trigger", "billboard", "cutscene_camera", "sfx-emitter")
#: Attribute of an object of a scene that was part of a library object, and what comes before the
#: names of the instance's own attributes.
_PART, _INSTANCE = "stkzoo-part", "stkzoo-library-"
#: A model that the game's data always has, without a random hue.
_DRAWING_MODEL = "banana-low.spm"
_DRAWS, _NOTHING = "_stkzoo_draws", "_stkzoo_nothing"
#: A text in one of the game's scripts.
_QUOTED = re.compile(r'"([^"\n]*)"')

#: Levels of detail by the name of their group.
_Levels = dict[str, list[ET.Element]]


def thin_scenes(data: Path) -> None:
    """Thins all scenes and library objects of a data folder.

    Files are replaced, not written into: they may be links.

    Args:
        data: the folder ``data`` of a pack that is being made.

    Raises:
        AssetError: a description cannot be read.
    """
    if not (data / "models" / _DRAWING_MODEL).is_file():
        return
    try:
        _thin(_Library(data), data)
    except ValueError as error:
        raise AssetError(f"the scenes in {data} cannot be read: {error}.") from error


def _thin(library: _Library, data: Path) -> None:
    for path in sorted(data.glob("tracks/*/scene.xml")):
        scene = parse_xml(path)
        if _SceneThinner(library).thin(scene):
            _replace(path, scene)
    for name, node in library.nodes.items():
        if node.gone:
            _replace(library.folder(name) / "node.xml", node.root)


def _replace(path: Path, root: ET.Element) -> None:
    path.unlink()
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


@dataclass(slots=True)
class _Node:
    """A library object.

    Attributes:
        whole: its description as it was.
        root: its description, thinned.
        has_body: whether anything in it can matter to a race.
        gone: the objects that ``root`` lacks.
        solids: the objects that can replace an instance; empty if none can.
    """

    whole: ET.Element
    root: ET.Element
    has_body: bool
    gone: Sequence[ET.Element] = ()
    solids: Sequence[ET.Element] = ()


class _Library:
    """What all scenes share: library objects, models, materials and the names in scripts."""

    def __init__(self, data: Path) -> None:
        self._data = data
        self.nodes: dict[str, _Node] = {}
        self._models: dict[str, list[Path]] = defaultdict(list)
        self._hues: set[str] = set()
        self._with_hue: dict[Path, bool] = {}
        self._in_tracks: set[str] = set()
        self._in_library: set[str] = set()
        for folder, _, names in os.walk(data):
            for name in names:
                self._note(Path(folder, name))

    def _note(self, path: Path) -> None:
        if path.suffix in (".spm", ".b3d"):
            self._models[path.name].append(path)
        elif path.suffix == ".as":
            is_tracks = path.is_relative_to(self._data / "tracks")
            names = self._in_tracks if is_tracks else self._in_library
            names.update(_QUOTED.findall(path.read_text("utf-8", "replace")))
        elif path.name == "materials.xml":
            entries = parse_xml(path).iter("material")
            self._hues |= {e.get("name", "").lower() for e in entries if e.get("hue-settings")}

    def folder(self, name: str) -> Path:
        """Where a library object lies."""
        return self._data / "library" / name

    def is_named(self, entry: ET.Element, *, in_library: bool = False) -> bool:
        """Whether a script may refer to it.

        The script of a library object refers to objects in it and in the scene.
        """
        name = entry.get("id", "")
        return name in self._in_tracks or (not in_library and name in self._in_library)

    def node(self, name: str) -> _Node:
        """A library object; one that is missing, or has a script or no body, is not thinned."""
        if name not in self.nodes:
            path = self.folder(name) / "node.xml"
            whole = parse_xml(path) if path.is_file() else ET.Element("scene")
            has_script = path.with_name("scripting.as").exists()
            can_change = path.is_file() and not has_script
            self.nodes[name] = self._thin_node(whole) if can_change else _Node(whole, whole, True)
        return self.nodes[name]

    def _thin_node(self, whole: ET.Element) -> _Node:
        gone = [entry for entry in whole if self.can_go(entry, in_library=True)]
        rest = [entry for entry in whole if entry not in gone and entry.tag != "lod"]
        if not rest:
            return _Node(whole, whole, has_body=False)
        root, levels = copy.copy(whole), _levels(whole)
        for entry in gone:
            _exchange(root, entry, self.hue_draws(entry, levels))
        stand_alone = all(map(self._stands_alone, rest))
        solids = [entry for entry in root if entry.tag != "lod"] if stand_alone else []
        return _Node(whole, root, True, gone, solids)

    def can_go(self, entry: ET.Element, *, in_library: bool = False) -> bool:
        """Whether it is only seen or heard."""
        if self.is_named(entry, in_library=in_library):
            return False
        type_name = entry.get("type", "")
        if entry.tag in _SEEN:
            return True
        if entry.tag != "object":
            return False
        if type_name == "billboard":
            return True
        if type_name == "sfx-emitter":  # one with a trigger is a check of the track
            return not is_true(entry, "play-when-near")
        if type_name in _NO_MODEL or is_true(entry, "driveable") or is_true(entry, "soccer_ball"):
            return False
        has_body = entry.get("interaction", "static") not in _WITHOUT_BODY
        return not has_body and bool(self._models[_model(entry)] or entry.get("lod_group"))

    def _stands_alone(self, entry: ET.Element) -> bool:
        """Whether an object of a library object can be an object of the scene."""
        return (
            entry.tag == "object"
            and entry.get("type") == "animation"
            and entry.get("interaction", "static") in ("static", "physicsonly")
            and entry.find("curve") is None
            and not any(is_true(entry, name) for name in ("lod_instance", "driveable"))
            and not any(entry.get(name) for name in ("if", "on-kart-collision", "renderpass"))
            and not self.is_named(entry, in_library=True)
            and not np.any(_three(entry, "hpr", 0.0))
        )

    def hue_draws(self, entry: ET.Element, levels: _Levels) -> list[ET.Element]:
        """What draws the random hue of an object that goes; empty if it has none."""
        group = levels.get(entry.get("lod_group", ""), [])
        model = _model(entry) or (_model(group[0]) if group else "")
        is_model = entry.tag == "object" and entry.get("type", "") not in _NO_MODEL
        if not is_model or not any(map(self._has_hue, self._models[model])):
            return []
        names = {"type": "animation", "interaction": "ghost", "model": model}
        names |= {"lod_instance": "true", "lod_group": _NOTHING}
        return [ET.Element("object", names)]

    def _has_hue(self, model: Path) -> bool:
        if model not in self._with_hue:
            textures = read_textures(model) if model.suffix == ".spm" else self._hues
            names = (name.rpartition("/")[2].lower() for name in textures)
            self._with_hue[model] = any(name in self._hues for name in names)
        return self._with_hue[model]


class _SceneThinner:
    """Thins one scene, in the order in which the game loads it."""

    def __init__(self, library: _Library) -> None:
        self._library = library
        self._levels: _Levels = defaultdict(list)
        self._met: set[str] = set()
        self._draws = 0

    def thin(self, scene: ET.Element) -> bool:
        """Whether anything changed."""
        self._levels |= _levels(scene)
        entries = list(scene)
        for entry in entries:
            if self._library.can_go(entry):
                self._draws += self._level_draws(entry)
                _exchange(scene, entry, self._library.hue_draws(entry, self._levels))
            elif entry.tag == "library":
                self._thin_instance(scene, entry)
        if self._draws:
            _add_draws(scene, self._draws)
        return list(scene) != entries

    def _thin_instance(self, scene: ET.Element, entry: ET.Element) -> None:
        name = entry.get("name", "")
        is_first = name not in self._met
        node = self._library.node(name)
        if node.has_body or is_first or self._library.is_named(entry):
            self._load(name)
            if node.solids and not is_first and self._can_open(entry):
                _exchange(scene, entry, _opened(node.solids, entry))
        else:
            self._draws += sum(map(self._level_draws, node.whole))
            draws = (self._library.hue_draws(child, self._levels) for child in node.whole)
            _exchange(scene, entry, list(itertools.chain.from_iterable(draws)))

    def _load(self, name: str) -> None:
        """Counts the draws that an instance no longer makes, with those of instances in it."""
        node = self._library.node(name)
        if name not in self._met:
            self._met.add(name)
            for group, levels in _levels(node.whole).items():
                self._levels[group] += levels
        for entry in node.whole:
            if entry.tag == "library":
                self._load(entry.get("name", ""))
            elif entry in node.gone:
                self._draws += self._level_draws(entry)

    def _can_open(self, entry: ET.Element) -> bool:
        """Whether the objects of an instance can be put into the scene instead, bit for bit."""
        is_plain = not len(entry) and not entry.get("if") and not self._library.is_named(entry)
        scale = _three(entry, "scale", 1.0)
        return is_plain and not np.any(_three(entry, "hpr", 0.0)) and bool(np.all(scale > 0.0))

    def _level_draws(self, entry: ET.Element) -> int:
        """How many numbers the levels of detail of an object draw."""
        if not is_true(entry, "lod_instance"):
            return 0
        group = self._levels.get(entry.get("lod_group", ""), [])
        far = [int(float(level.get("lod_distance", -1))) ** 2 for level in group]
        return sum(after > before for before, after in itertools.pairwise(far))


def _exchange(parent: ET.Element, entry: ET.Element, others: list[ET.Element]) -> None:
    place = list(parent).index(entry)
    parent[place : place + 1] = others


def _add_draws(scene: ET.Element, count: int) -> None:
    """Adds an object with so many levels of detail that loading it draws ``count`` numbers."""
    lod = scene.find("lod")
    group = ET.SubElement(ET.SubElement(scene, "lod") if lod is None else lod, "group", name=_DRAWS)
    for level in range(count + 1):
        names = {"lod_group": _DRAWS, "model": _DRAWING_MODEL, "lod_distance": str(level + 1)}
        ET.SubElement(group, "static-object", names)
    names = {"type": "animation", "interaction": "ghost", "lod_instance": "true"}
    ET.SubElement(scene, "object", names | {"lod_group": _DRAWS})


def _opened(solids: Sequence[ET.Element], instance: ET.Element) -> list[ET.Element]:
    """The objects of a library object at their places in the scene.

    The first one says which instance they were. An attribute does, because the game takes every
    child of an object for a curve that moves it.
    """
    placed = [_placed(solid, instance) for solid in solids]
    for name in ("name", "xyz", "scale"):
        if name in instance.attrib:
            placed[0].set(_INSTANCE + name, instance.attrib[name])
    return placed


def opened_instance(entry: ET.Element) -> ET.Element | None:
    """Returns the instance of a library object that an object of a scene belongs to.

    Returns:
        ``None`` if there is none. Only the first object of an instance knows its name.
    """
    if not entry.get(_PART):
        return None
    names = (name for name in entry.attrib if name.startswith(_INSTANCE))
    instance = {name.removeprefix(_INSTANCE): entry.attrib[name] for name in names}
    return ET.Element("library", instance)


def _placed(solid: ET.Element, instance: ET.Element) -> ET.Element:
    """One object at its place, by the game's own arithmetic."""
    placed = copy.deepcopy(solid)
    placed.set(_PART, "true")
    if solid.get("lod_group") == _NOTHING:
        return placed
    scale = _three(instance, "scale", 1.0)
    place = scale * _three(solid, "xyz", 0.0) + _three(instance, "xyz", 0.0)
    size = scale * _three(solid, "scale", 1.0)
    for name, values in (("xyz", place), ("scale", size)):
        placed.set(name, " ".join(f"{value:.9g}" for value in values))
    return placed


def _three(entry: ET.Element, name: str, missing: float) -> npt.NDArray[np.float32]:
    words = entry.get(name, "").split() or [str(missing)] * 3
    return np.array([float(word) for word in words], np.float32)


def _levels(root: ET.Element) -> _Levels:
    levels: _Levels = defaultdict(list)
    for group in root.iterfind("lod/*"):
        for level in group:
            levels[level.get("lod_group", "")].append(level)
    return levels


def _model(entry: ET.Element) -> str:
    return entry.get("model", "")
