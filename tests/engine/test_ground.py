"""The ground and walls, as read from meshes and as in the game."""

import struct

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.config import Start
from stkzoo.engine.assets.mesh import read_mesh
from stkzoo.engine.ground import (
    Faces,
    Ground,
    read_scenery,
)
from stkzoo.errors import AssetError, ConfigError
from stkzoo.names import GroundKind

VOID, GROUND, SLOWED, ZIPPER, WALL = GroundKind

# ------------------------------------------------------------------ meshes


def mesh_file(path, parts, flags=3, kind=2):
    """Writes a mesh of parts (texture, vertices, triangles). Every second vertex has a color."""
    data = b"SP" + bytes([1 << 3 | kind, flags]) + bytes(24)
    data += struct.pack("<H", len(parts))
    for texture, _, _ in parts:
        data += bytes([len(texture)]) + texture.encode() + b"\0"
    data += struct.pack("<HH", 1, len(parts))
    for number, (texture, vertices, triangles) in enumerate(parts):
        data += struct.pack("<IIH", len(vertices), 3 * len(triangles), number)
        for index, vertex in enumerate(vertices):
            data += struct.pack("<3f", *vertex)
            data += bytes(4) * (flags & 1)
            if flags & 2:
                data += bytes([0, 1, 2, 3]) if index % 2 else bytes([128])
            data += bytes(4) * bool(texture)
        kind_of = "<u2" if len(vertices) > 255 else "u1"
        data += np.array(triangles, kind_of).tobytes()
    path.write_bytes(data)


CORNERS = [(0, 0, 0), (4, 0, 0), (4, 0, 4), (0, 1, 4)]
SQUARE = [(0, 1, 2), (0, 2, 3)]


@pytest.mark.parametrize("flags", [0, 1, 2, 3])
def test_a_mesh_survives_a_round_trip(tmp_path, flags):
    many = [(float(n), 0, 1) for n in range(300)]
    mesh_file(
        tmp_path / "a.spm",
        [("road.png", CORNERS, SQUARE), ("", many, [(0, 1, 299)])],
        flags,
    )
    road, other = read_mesh(tmp_path / "a.spm")
    assert (road.texture, other.texture) == ("road.png", "")
    np.testing.assert_array_equal(road.vertices, np.array(CORNERS, np.float32))
    np.testing.assert_array_equal(road.triangles, SQUARE)
    np.testing.assert_array_equal(other.vertices[299], [299, 0, 1])
    np.testing.assert_array_equal(other.triangles, [(0, 1, 299)])


@pytest.mark.parametrize(
    ("triangles", "damaged"),
    [
        (SQUARE, lambda data: data[:-20]),
        (SQUARE, lambda data: b"SP\x12" + data[3:]),
        ([(0, 1, 9)], lambda data: data),
    ],
    ids=["short", "version", "corner"],
)
def test_a_damaged_mesh_is_named(tmp_path, triangles, damaged):
    file = tmp_path / "a.spm"
    mesh_file(file, [("road.png", CORNERS, triangles)])
    file.write_bytes(damaged(file.read_bytes()))
    with pytest.raises(AssetError, match=r"a\.spm.*is not a mesh"):
        read_mesh(file)


# ------------------------------------------------------------------ scenes


def write_track(tmp_path, scene, materials=""):
    """Writes game data with one track that has the given scene."""
    folder = tmp_path / "tracks" / "toy"
    folder.mkdir(parents=True)
    mesh_file(folder / "road.spm", [("road.png", CORNERS, SQUARE)])
    mesh_file(folder / "post.spm", [("post.png", CORNERS, SQUARE[:1])])
    (folder / "scene.xml").write_text(
        f'<scene><track model="road.spm" x="0" y="0" z="0">{scene[0]}</track>{scene[1]}</scene>'
    )
    (folder / "materials.xml").write_text(f"<materials>{materials}</materials>")
    return tmp_path


def corners(faces, first=2):
    """Returns the corners of all faces except the road's."""
    return faces.corners[first:]


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ('xyz="10 2 -3"', [(10, 2, -3), (14, 2, -3), (14, 2, 1)]),
        ('xyz="0 0 0" scale="2 1 0.5"', [(0, 0, 0), (8, 0, 0), (8, 0, 2)]),
        ('xyz="0 0 0" hpr="0 90 0"', [(0, 0, 0), (0, 0, -4), (4, 0, -4)]),
        ('xyz="0 0 0" hpr="90 90 0"', [(0, 0, 0), (0, 0, -4), (0, -4, -4)]),
    ],
)
def test_objects_are_placed_as_in_the_scene(tmp_path, place, expected):
    data = write_track(tmp_path, (f'<static-object model="post.spm" {place}/>', ""))
    faces = read_scenery(data, "toy")
    np.testing.assert_allclose(corners(faces)[0], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("inner", "outer", "count"),
    [
        ('<static-object model="post.spm" interaction="ghost"/>', "", 0),
        ('<static-object model="post.spm" interaction="physics-only"/>', "", 1),
        ('<static-object model="sky.dds"/>', "", 0),
        ("", '<object type="animation" interaction="static" model="post.spm"/>', 1),
        ("", '<object type="animation" interaction="ghost" model="post.spm"/>', 0),
        ("", '<object type="animation" model="post.spm" interaction="static"><curve/></object>', 0),
        ("", '<object type="movable" model="post.spm"/>', 0),
        ('<static-object model="post.spm" if="isTrackReverse"/>', "", 0),
        ('<static-object model="post.spm" if="isTrackNotReverse"/>', "", 1),
    ],
)
def test_only_solid_objects_are_read(tmp_path, inner, outer, count):
    data = write_track(tmp_path, (inner, outer))
    assert len(corners(read_scenery(data, "toy"))) == count


def test_some_objects_exist_in_one_direction_only(tmp_path):
    data = write_track(tmp_path, ('<static-object model="post.spm" if="isReverse"/>', ""))
    assert len(corners(read_scenery(data, "toy", reverse=True))) == 1


def test_an_object_with_levels_of_detail_uses_the_first(tmp_path):
    groups = (
        '<lod><group name="g"><static-object model="post.spm" interaction="static"/>'
        '<static-object model="road.spm" interaction="static"/></group></lod>'
    )
    thing = '<static-object lod_instance="true" lod_group="g" xyz="1 0 0"/>'
    data = write_track(tmp_path, (thing, groups))
    np.testing.assert_array_equal(corners(read_scenery(data, "toy"))[:, 0], [(1, 0, 0)])


def test_a_library_has_its_own_place_and_materials(tmp_path):
    data = write_track(tmp_path, ("", '<library name="posts" xyz="0 5 0"/>'))
    folder = tmp_path / "library" / "posts"
    folder.mkdir(parents=True)
    mesh_file(folder / "one.spm", [("post.png", CORNERS, SQUARE[:1])])
    (folder / "node.xml").write_text('<scene><static-object model="one.spm" xyz="0 0 7"/></scene>')
    (folder / "materials.xml").write_text(
        '<materials><material name="POST.png" max-speed="0.5"/></materials>'
    )
    faces = read_scenery(data, "toy")
    np.testing.assert_array_equal(corners(faces)[0, 0], (0, 5, 7))
    np.testing.assert_array_equal(faces.speed, [1, 1, 0.5])


@pytest.mark.parametrize("words", ['ignore="Y"', 'surface="Y"'])
def test_some_materials_are_not_solid(tmp_path, words):
    materials = f'<material name="post.png" {words}/>'
    data = write_track(tmp_path, ('<static-object model="post.spm"/>', ""), materials)
    assert len(corners(read_scenery(data, "toy"))) == 0


def test_materials_determine_the_kind_of_faces(tmp_path):
    materials = (
        '<material name="road.png" reset="Y"/><material name="post.png"><zipper/></material>'
    )
    faces = read_scenery(
        write_track(tmp_path, ('<static-object model="post.spm"/>', ""), materials), "toy"
    )
    np.testing.assert_array_equal(faces.is_reset, [True, True, False])
    np.testing.assert_array_equal(faces.is_zipper, [False, False, True])


# ------------------------------------------------------------------ columns


def plate(x, z, height, *, to=None, **words):
    """Returns two faces over an area ``x`` by ``z`` that rise from ``height`` to ``to`` along z."""
    far = height if to is None else to
    a, b, c, d = (
        (x[0], height, z[0]),
        (x[1], height, z[0]),
        (x[1], far, z[1]),
        (x[0], far, z[1]),
    )
    return [(a, b, c), (a, c, d)], words


def wall(x, z, height):
    """Returns two faces of a wall along z."""
    a, b = (x, height[0], z[0]), (x, height[0], z[1])
    c, d = (x, height[1], z[1]), (x, height[1], z[0])
    return [(a, b, c), (a, c, d)], {}


def ground_with(*things):
    corners_ = np.array([face for faces, _ in things for face in faces], np.float32)

    def of_each(name, missing):
        return np.array([words.get(name, missing) for faces, words in things for _ in faces])

    faces = Faces(
        corners_,
        of_each("speed", 1.0).astype(np.float32),
        of_each("is_reset", False),
        of_each("is_zipper", False),
    )
    return Ground(faces, np.stack([np.zeros(41), np.zeros(41), np.arange(41.0)], axis=1))


FLOOR = plate((-10, 10), (0, 40), 0.0)


def kinds(ground, *places):
    return ground.at(np.array(places, float)).kind.tolist()


def test_there_is_nothing_beyond_the_ground():
    ground = ground_with(FLOOR)
    assert kinds(ground, (0, 0.5, 20), (9, 0.5, 20), (11, 0.5, 20)) == [GROUND, GROUND, VOID]
    assert kinds(ground, (500, 0, 20), (0, 9, 20)) == [VOID, VOID]


def test_the_height_follows_a_slope():
    ground = ground_with(plate((-10, 10), (0, 40), 0.0, to=8.0))
    spots = ground.at(np.array([(3.25, 2.1, 10.25), (3.25, 3.0, 20.25)]))
    np.testing.assert_allclose(spots.height, [2.05, 4.05], atol=0.01)
    assert spots.kind.tolist() == [GROUND, GROUND]


def test_walls_block_karts_but_curbs_and_signs_do_not():
    ground = ground_with(
        FLOOR,
        wall(2.1, (5, 10), (0, 2)),
        wall(2.1, (15, 20), (0, 0.3)),
        wall(2.1, (25, 30), (1.2, 4)),
    )
    at = [(2.25, 0, 7), (2.25, 0, 17), (2.25, 0, 27)]
    assert kinds(ground, *at) == [WALL, GROUND, GROUND]
    assert kinds(ground, (0, 0, 7), (4, 0, 7)) == [GROUND, GROUND]


def test_a_steep_slope_is_a_wall():
    steep, gentle = (plate((-10, 10), (10, 14), 0.0, to=to) for to in (8.0, 1.5))
    assert WALL in kinds(ground_with(FLOOR, steep), *[(0, 0.5, 9 + n / 4) for n in range(8)])
    assert WALL not in kinds(ground_with(FLOOR, gentle), *[(0, 0.5, 9 + n / 4) for n in range(8)])


def test_a_bridge_and_the_road_below_it_are_two_levels():
    ground = ground_with(
        FLOOR, plate((-3, 3), (10, 20), 5.0, speed=0.5), wall(1.1, (10, 20), (5, 7))
    )
    below, above, post = ground.at(np.array([(0, 0.3, 15), (0, 5.3, 15), (1.25, 5.3, 15)])).kind
    assert (below, above, post) == (GROUND, SLOWED, WALL)
    assert kinds(ground, (1.25, 0.3, 15)) == [GROUND]


def test_kinds_of_ground():
    ground = ground_with(
        FLOOR,
        plate((-9, -6), (0, 40), 0.05, is_zipper=True),
        plate((6, 9), (0, 40), 0.05, speed=0.3),
        plate((1, 4), (0, 40), 0.05, is_reset=True),
    )
    spots = ground.at(np.array([(-7.5, 0, 9), (7.5, 0, 9), (2.5, 0, 9), (0, 0, 9)], float))
    assert spots.kind.tolist() == [ZIPPER, SLOWED, VOID, GROUND]
    np.testing.assert_allclose(spots.speed, [1, 0.3, 1, 1])


def test_places_can_have_any_shape():
    spots = ground_with(FLOOR).at(np.zeros((2, 5, 3)))
    assert spots.kind.shape == spots.height.shape == spots.speed.shape == (2, 5)


@pytest.mark.parametrize("places", [np.zeros(2), 0.0, [[0, np.nan, 0]], [0, np.inf, 0]])
def test_invalid_places_are_refused(places):
    with pytest.raises(ConfigError, match=r"expected finite numbers \(\.\.\., 3\)"):
        ground_with(FLOOR).at(places)


def test_places_far_away_have_no_ground():
    assert kinds(ground_with(FLOOR), (1e300, 0, 0), (0, 0, -1e20)) == [VOID, VOID]


# ------------------------------------------------------------------ the game's own tracks


def race_of_bots(track, reverse, steps):
    """Returns the ground, four bots' positions ``(steps, 4, 3)``, and whether each is airborne."""
    with race_v0.parallel_env(
        agents=1, num_kart=5, track=track, reverse=reverse, difficulty=3, max_paths=1
    ) as env:
        env.reset(seed=3)
        idle = {"acceleration": np.zeros(1, np.float32), "steer": np.zeros(1, np.float32)}
        idle |= dict.fromkeys(("brake", "drift", "fire", "nitro", "rescue"), 0)
        places, airborne = [], []
        for _ in range(steps):
            env.step({"kart_0": idle})
            karts = env.snapshot.karts[1:]
            places.append(karts["location"].copy())
            airborne.append(karts["jumping"] > 0)
        return env.ground, np.array(places), np.array(airborne)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("track", "reverse"), [("stk_enterprise", False), ("volcano_island", True), ("minigolf", False)]
)
def test_bots_drive_on_ground_and_not_in_walls(track, reverse):
    ground, places, airborne = race_of_bots(track, reverse, 300)
    driven = places[30:][~airborne[30:]]
    spots = ground.at(driven)
    assert np.mean(spots.kind == WALL) < 0.02
    assert np.mean(spots.kind == VOID) < 0.03
    is_there = np.isfinite(spots.height)
    assert np.median(np.abs(spots.height - driven[:, 1])[is_there]) < 0.3


@pytest.mark.slow
def test_a_kart_stops_at_a_wall():
    with race_v0.parallel_env(agents=1, num_kart=1, track="stk_enterprise", max_paths=1) as env:
        env.reset(seed=1, options={"start": Start(distance=330.0, heading=np.pi / 2)})
        ahead = {"acceleration": np.ones(1, np.float32), "steer": np.zeros(1, np.float32)}
        ahead |= dict.fromkeys(("brake", "drift", "fire", "nitro", "rescue"), 0)
        kart = env.snapshot.karts[0]
        begin, way = kart["location"].copy(), kart["front"] - kart["location"]
        way = way / np.linalg.norm(way)
        line = begin + way * np.arange(0, 12, 0.1)[:, None]
        is_wall = env.ground.at(line).kind == WALL
        assert is_wall.any()
        wall_at = 0.1 * is_wall.argmax()
        farthest = 0.0
        for _ in range(40):
            env.step({"kart_0": ahead})
            farthest = max(farthest, float((env.snapshot.karts[0]["location"] - begin) @ way))
        assert wall_at - 2.0 < farthest < wall_at + 0.5


def test_a_track_is_read_once_at_the_first_reset():
    with race_v0.parallel_env(agents=1, num_kart=1, track="olivermath", max_paths=1) as env:
        assert env.ground is None
        env.reset(seed=1)
        first = env.ground
        env.reset(seed=2)
        assert env.ground is first
