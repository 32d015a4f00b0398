"""The solid faces of a track: its meshes, placed as its scene describes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.engine.assets.mesh import Part, read_mesh
from stkzoo.engine.assets.scenes import opened_instance
from stkzoo.engine.assets.tree import parse_xml

FloatArray = npt.NDArray[np.float64]

#: Kinds of interaction for objects that karts drive through, or that move.
_NOT_SOLID = ("ghost", "none", "explode")
_SOLID_OBJECTS = ("static", "physics-only", "physicsonly")
_YES = "Y"


@dataclass(frozen=True, slots=True)
class Faces:
    """``F`` triangles.

    Attributes:
        corners: ``(F, 3, 3)`` float32 [m], world frame.
        speed: ``(F,)`` float32: maximum speed on a face as a fraction of a kart's top speed.
        is_reset: ``(F,)`` bool: whether the game puts karts that touch a face back on the road.
        is_zipper: ``(F,)`` bool: whether a face accelerates karts.
    """

    corners: npt.NDArray[np.float32]
    speed: npt.NDArray[np.float32]
    is_reset: npt.NDArray[np.bool_]
    is_zipper: npt.NDArray[np.bool_]


#: Properties of a material, as in :class:`Faces`.
_MATERIAL = np.dtype([("speed", "f4"), ("is_reset", "?"), ("is_zipper", "?")])
_PLAIN = (1.0, False, False)

#: Materials by the lower-case name of their texture: values of :data:`_MATERIAL`, or ``None`` for a
#: material that is not solid.
_Materials = dict[str, tuple[float, bool, bool] | None]


def read_scenery(data: Path, track: str, *, reverse: bool = False) -> Faces:
    """Returns the solid faces of a track at the start of a race.

    Args:
        data: the ``data`` folder of the game.
        track: name of the track.
        reverse: whether the race is in reverse. Some objects exist in one direction only.

    Raises:
        AssetError: a file is missing or broken.
    """
    folder = data / "tracks" / track
    scene = parse_xml(folder / "scene.xml")
    reader = _SceneReader(data, reverse)
    common = _materials(data / "textures" / "materials.xml")
    reader.walk(scene, folder, np.eye(4), common | _materials(folder / "materials.xml"), scene)
    return reader.faces()


class _SceneReader:
    """Collects the faces of a scene and of the library objects that it names."""

    def __init__(self, data: Path, reverse: bool) -> None:
        self._data, self._reverse = data, reverse
        self._meshes: dict[Path, list[Part]] = {}  # a cache; a scene can use a mesh many times
        self._corners: list[FloatArray] = []
        self._of: list[tuple[float, bool, bool]] = []

    def walk(
        self,
        node: ET.Element,
        folder: Path,
        place: FloatArray,
        materials: _Materials,
        scene: ET.Element,
    ) -> None:
        """Adds the objects below a node.

        Args:
            node: the node.
            folder: folder of the node's models.
            place: ``(4, 4)`` matrix from the node to the world frame.
            materials: materials of the models.
            scene: root of the node's file, which defines its level-of-detail groups.
        """
        for entry in node:
            if not self._is_there(entry):
                continue
            if entry.tag == "library":
                self._library(entry, place, materials)
            elif (instance := opened_instance(entry)) is not None:
                self._library(instance, place, materials)
            elif entry.tag in ("track", "static-object", "object") and _is_solid(entry):
                model = _model(entry, scene)
                if model:
                    self._add(folder / model, place @ _matrix(entry), materials)
            if entry.tag == "track":
                self.walk(entry, folder, place, materials, scene)

    def faces(self) -> Faces:
        counts = [len(corners) for corners in self._corners]
        materials = np.repeat(np.array(self._of, _MATERIAL), counts)
        corners = np.concatenate(self._corners).astype(np.float32)
        return Faces(corners, *(materials[name].copy() for name in _MATERIAL.names or ()))

    def _library(self, entry: ET.Element, place: FloatArray, materials: _Materials) -> None:
        folder = self._data / "library" / entry.get("name", "")
        if entry.find("curve") is None and (folder / "node.xml").exists():
            node = parse_xml(folder / "node.xml")
            known = materials | _materials(folder / "materials.xml")
            self.walk(node, folder, place @ _matrix(entry), known, node)

    def _add(self, file: Path, place: FloatArray, materials: _Materials) -> None:
        if file not in self._meshes:
            self._meshes[file] = read_mesh(file)
        for part in self._meshes[file]:
            material = materials.get(part.texture.rpartition("/")[2].lower(), _PLAIN)
            if material is not None:
                world = part.vertices @ place[:3, :3].T + place[:3, 3]
                self._corners.append(world[part.triangles])
                self._of.append(material)

    def _is_there(self, entry: ET.Element) -> bool:
        """Returns whether an object exists in this race.

        The object's attribute ``if`` names a condition function of the game.
        """
        condition = entry.get("if", "")
        if condition.endswith("EasterEgg"):
            return False
        if condition.endswith("Reverse"):
            return ("Not" not in condition) == self._reverse
        return True


def _is_solid(entry: ET.Element) -> bool:
    interaction = entry.get("interaction")
    if entry.tag == "object":
        return (
            entry.get("type") == "animation"
            and interaction in _SOLID_OBJECTS
            and entry.find("curve") is None
        )
    return interaction not in _NOT_SOLID


def _model(entry: ET.Element, scene: ET.Element) -> str:
    """Returns the file name of an object's model; empty if it has no solid model."""
    if entry.get("lod_instance") == "true":
        name = entry.get("lod_group")
        for group in scene.iter("group"):
            if group.get("name") == name and len(group) and _is_solid(group[0]):
                return group[0].get("model", "")
        return ""
    model = entry.get("model", "")
    return model if model.endswith(".spm") else ""


def _matrix(entry: ET.Element) -> FloatArray:
    """Returns the ``(4, 4)`` matrix that places an object.

    It scales by ``scale``, rotates about x, then y, then z by ``hpr`` [degrees], and moves to
    ``xyz`` [m].
    """
    turns = [_turn(axis, angle) for axis, angle in enumerate(np.radians(_three(entry, "hpr", 0)))]
    matrix = np.eye(4)
    matrix[:3, :3] = turns[2] @ turns[1] @ turns[0] @ np.diag(_three(entry, "scale", 1))
    matrix[:3, 3] = _three(entry, "xyz", 0)
    return matrix


def _three(entry: ET.Element, name: str, missing: float) -> list[float]:
    if entry.get(name):
        return [float(word) for word in entry.get(name, "").split()]
    single = list(name) if name != "scale" else []
    return [float(entry.get(letter, missing)) for letter in single] or [missing] * 3


def _turn(axis: int, angle: float) -> FloatArray:
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[one, one] = turn[other, other] = np.cos(angle)
    turn[other, one], turn[one, other] = np.sin(angle), -np.sin(angle)
    return turn


def _materials(path: Path) -> _Materials:
    materials: _Materials = {}
    for entry in parse_xml(path).iter("material") if path.exists() else ():
        is_solid = _YES not in (entry.get("ignore"), entry.get("surface"))
        speed = float(entry.get("max-speed", 1.0)) or 1.0
        values = speed, entry.get("reset") == _YES, entry.find("zipper") is not None
        materials[entry.get("name", "").lower()] = values if is_solid else None
    return materials
