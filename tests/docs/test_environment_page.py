"""The environment's reference page matches the code."""

import inspect
import re

import numpy as np
from gymnasium import spaces

import stkzoo
from stkzoo import race_v0
from stkzoo.cli import COMMANDS
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.views import CAMERA_VIEWS, VIEWS
from stkzoo.views.split_step import MonoAgentEnv
from tests.support.paths import ROOT

PAGE = (ROOT / "docs" / "reference" / "environment.md").read_text("utf-8")


def section(heading, level="##"):
    (text,) = re.findall(rf"^{level} {heading}\n(.*?)(?=^{level[:2]} |\Z)", PAGE, re.M | re.S)
    return text


def rows(text):
    """Returns the cells of each row of the tables in a text."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def keys(text):
    return {cell[0].strip("`") for cell in rows(text) if cell[0].startswith("`")}


def test_all_observations_are_documented_with_their_shapes():
    text = section("Observation space")
    space = kart_observation_space(use_ai=True, extras=["ground"])
    table = {row[0].strip("`"): row for row in rows(text.split("(flattened-order)")[0])}
    assert set(space.spaces) <= set(table)
    for key, part in space.spaces.items():
        shape = table[key][1]
        entry = part.feature_space if isinstance(part, spaces.Sequence) else part
        if isinstance(entry, spaces.Box):
            assert f"`{entry.shape}` {entry.dtype}" in shape, key
        elif isinstance(entry, spaces.Discrete):
            assert shape.endswith("int"), key
            assert table[key][2] in (f"0 to {entry.n - 1}", "0, 1"), key


def test_all_actions_are_documented():
    assert keys(section("Action space")) >= set(kart_action_space().spaces)


def test_all_enumeration_members_are_documented():
    for kind in (
        stkzoo.Phase,
        stkzoo.PowerupType,
        stkzoo.AttachmentType,
        stkzoo.ItemType,
        stkzoo.GroundKind,
    ):
        for member in kind:
            assert f"{member.value} `{member.name}`" in re.sub(r"\s+", " ", PAGE), member


def test_all_arguments_are_documented_with_their_defaults():
    told = {row[0].strip("`"): row[1].strip("`") for row in rows(section("Arguments"))}
    arguments = inspect.signature(race_v0.parallel_env.__init__).parameters
    for name, argument in arguments.items():
        if name != "self":
            assert told[name] == repr(argument.default).replace("'", '"'), name


def test_all_views_are_documented_with_their_sizes():
    assert keys(section("Views")) == set(VIEWS) | set(CAMERA_VIEWS)
    with race_v0.parallel_env(num_kart=1, track="lighthouse", view="box_discrete") as env:
        assert "(164,)" in PAGE
        assert env.observation_space("kart_0").shape == (164,)
        assert env.action_space("kart_0").n == 1120


def test_the_order_of_the_flattened_vector_is_documented():
    simple = race_v0.parallel_env(num_kart=2, track="lighthouse", view="simple")
    space = simple.observation_space("kart_0")
    simple.close()
    text = section("The flattened vectors", "###")
    for number in ("continuous", "discrete"):
        column = 0 if number == "continuous" else 2
        told = [
            (row[column], row[column + 1].strip("`"))
            for row in rows(text)
            if len(row) == 4 and row[column + 1].startswith("`")
        ]
        begin = 0
        wanted = [
            key
            for key in sorted(space.spaces)
            if isinstance(space[key], spaces.Box) == (number == "continuous")
            and not isinstance(space[key], spaces.Text)
        ]
        assert [key for _, key in told] == wanted
        for place, key in told:
            size = int(np.prod(space[key].shape or ()))
            last = begin + size - 1
            assert place == (f"{begin} to {last}" if size > 1 else str(begin)), key
            begin += size


def test_the_formula_for_discrete_actions_is_correct():
    base = MonoAgentEnv(kart_observation_space(), kart_action_space(), None)
    flat = VIEWS["flattened_discrete"](base)
    # acceleration, brake, drift, fire, nitro, rescue, steer
    assert flat.action(4 + 5 + 40 + 160 * 6).tolist() == [4, 1, 0, 0, 1, 0, 6]
    assert "`a + 5 brake + 10 drift + 20 fire + 40 nitro +\n80 rescue + 160 s`" in PAGE


def test_all_infos_are_documented():
    told = keys(section("Infos"))
    with race_v0.parallel_env(num_kart=1, track="lighthouse") as env:
        _, infos = env.reset(seed=1)
    for key in infos["kart_0"]:
        general = re.sub(r"^(episode/)?reward/.*", r"\1reward/<term>", key)
        assert general in told or f"`{general}`" in section("Infos"), key


def test_all_commands_are_documented():
    page = (ROOT / "docs" / "reference" / "cli.md").read_text("utf-8")
    assert all(command in page for command in COMMANDS)
