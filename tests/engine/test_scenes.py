import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from stkzoo.engine.assets import Progress, find_assets
from stkzoo.engine.assets.headless import build_headless
from stkzoo.engine.assets.scenes import thin_scenes
from stkzoo.engine.ground import read_scenery
from stkzoo.errors import AssetError
from stkzoo.tracks import SPLITS
from tests.support.views import marked

#: Runs a race of two players and four bots; prints a digest of all karts and items.
RACE = """
import hashlib, json, sys
import numpy as np
from stkzoo import race_v0
from stkzoo.mdp import action_of

track, reverse = sys.argv[1], sys.argv[2] == "True"
digest = hashlib.sha256()
with race_v0.parallel_env(num_kart=6, agents=2, track=track, reverse=reverse) as env:
    env.reset(seed=3)
    for step in range(200):
        turn = 0.4 if step // 7 % 2 else -0.4
        action = action_of(np.array([1.0, turn, 0, 0, step % 9 == 0, 0, step == 120], np.float32))
        env.step(dict.fromkeys(env.agents, action))
        karts, items = env.snapshot.karts, env.snapshot.items
        for records in (karts["location"], karts["velocity"], items["location"]):
            digest.update(np.ascontiguousarray(records).tobytes())
print(json.dumps(digest.hexdigest()))
"""


def spm_file(texture):
    """Returns the beginning of an .spm file; the rest is not read."""
    name = texture.encode()
    return b"SP\x08\x00" + bytes(24) + b"\x01\x00" + bytes([len(name)]) + name + b"\x00"


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


GHOST = '<object id="{0}" type="animation" interaction="ghost" model="{0}.spm"/>'
TRUNK = (
    '<object id="trunk" type="animation" interaction="physicsonly" shape="cylinderY" '
    'model="trunk.spm" xyz="0.0 0.89 0.0" hpr="0.0 -0.0 0.0" scale="1.0 1.0 1.0"/>'
)


@pytest.fixture
def data(tmp_path):
    """Writes a data folder with models and without scenes."""
    for name in ("banana-low", "wall", "bush", "tree", "trunk", "lamp"):
        write(tmp_path / "models" / f"{name}.spm", spm_file("plain.png"))
    return tmp_path


def thin(data, scene, **libraries):
    """Thins a track's scene with the given library objects, and returns it."""
    write(data / "tracks" / "alps" / "scene.xml", f"<scene>{scene}</scene>")
    for name, node in libraries.items():
        write(data / "library" / name / "node.xml", f"<scene>{node}</scene>")
    thin_scenes(data)
    return ET.parse(data / "tracks" / "alps" / "scene.xml").getroot()


def model_names(scene):
    return [entry.get("model") for entry in scene.iter("object")]


def instances(count):
    return "".join(f'<library name="plant" xyz="{i} 2 3"/>' for i in range(count))


class TestRemovedObjects:
    @pytest.mark.parametrize(
        "entry",
        [
            "<light/>",
            '<particle-emitter kind="fire.xml"/>',
            '<object type="billboard" texture="sun.png"/>',
            '<object type="sfx-emitter" sound="hum.ogg"/>',
            GHOST.format("bush"),
            '<object type="animation" interaction="none" model="bush.spm"/>',
        ],
    )
    def test_visual_and_audio_objects_are_removed(self, data, entry):
        assert not len(thin(data, entry))

    @pytest.mark.parametrize(
        "entry",
        [
            '<object type="animation" interaction="static" model="wall.spm"/>',
            '<object type="movable" model="wall.spm"/>',
            '<object type="sfx-emitter" sound="hum.ogg" play-when-near="true"/>',
            '<object type="action-trigger" action="jump"/>',
            '<object type="animation" interaction="ghost" driveable="true" model="bush.spm"/>',
            '<static-object interaction="ghost" model="bush.spm"/>',
            "<checks/>",
        ],
    )
    def test_objects_that_affect_a_race_are_kept(self, data, entry):
        assert len(thin(data, entry)) == 1

    def test_objects_in_a_script_are_kept(self, data):
        write(data / "tracks" / "alps" / "scripting.as", 'getTrackObject("", "bush")')
        assert model_names(thin(data, GHOST.format("bush") + GHOST.format("lamp"))) == ["bush.spm"]

    def test_first_instance_of_a_plant_is_kept(self, data):
        scene = thin(data, instances(3), plant=GHOST.format("bush"))
        assert [entry.get("xyz") for entry in scene] == ["0 2 3"]

    def test_library_object_with_a_script_is_kept(self, data):
        write(data / "library" / "plant" / "scripting.as", "")
        scene = thin(data, instances(3), plant=GHOST.format("bush"))
        assert len(scene) == 3

    def test_ghosts_of_a_solid_library_object_are_removed(self, data):
        thin(data, instances(1), plant=GHOST.format("bush") + TRUNK)
        node = ET.parse(data / "library" / "plant" / "node.xml")
        assert model_names(node.getroot()) == ["trunk.spm"]

    def test_hard_link_to_the_scene_keeps_its_content(self, data):
        path = data / "tracks" / "alps" / "scene.xml"
        write(path, "<scene><light/></scene>")
        os.link(path, data / "whole.xml")
        thin_scenes(data)
        assert (data / "whole.xml").read_text() == "<scene><light/></scene>"

    def test_bad_number_is_reported(self, data):
        bad = '<library name="plant" hpr="far 0 0"/>'
        with pytest.raises(AssetError, match=r"scenes in .* could not convert string"):
            thin(data, 2 * bad, plant=TRUNK)


@pytest.fixture(scope="module")
def packs(tmp_path_factory):
    """Builds a headless pack, with thinned scenes; returns the root of the full data and its."""
    full, thinned = find_assets(graphics=True).root, tmp_path_factory.mktemp("thinned")
    build_headless(full, thinned, Progress())
    return full, thinned


#: On cocoa_temple, bots choose among paths; on black_forest, most instances are replaced; a sound
#: changes the ground of xr591.
TRACKS = marked(SPLITS["all"], ["black_forest", "cocoa_temple", "xr591"])


class TestThinnedPack:
    @pytest.mark.slow
    @pytest.mark.parametrize("reverse", [False, pytest.param(True, marks=pytest.mark.matrix)])
    @pytest.mark.parametrize("track", TRACKS)
    def test_races_with_bots_are_the_same_bit_for_bit(self, packs, track, reverse):
        digests = {self.race(root, track, reverse) for root in packs}
        assert len(digests) == 1

    @pytest.mark.slow
    @pytest.mark.parametrize("track", ["black_forest", "olivermath"])
    def test_ground_is_the_same(self, packs, track):
        whole, thinned = (read_scenery(root / "data", track) for root in packs)
        assert np.array_equal(whole.corners, thinned.corners)
        assert np.array_equal(whole.speed, thinned.speed)

    @pytest.mark.slow
    def test_thinned_scenes_have_far_fewer_objects(self, packs):
        whole, thinned = (
            len(list(ET.parse(root / "data/tracks/cocoa_temple/scene.xml").iter("library")))
            for root in packs
        )
        assert thinned < whole / 3

    @staticmethod
    def race(root, track, reverse):
        process = subprocess.run(
            [sys.executable, "-c", RACE, track, str(reverse)],
            env={**os.environ, "SUPERTUXKART_DATADIR": str(root)},
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        )
        return json.loads(process.stdout.strip().splitlines()[-1])
