"""Views chosen by name, with options."""

from __future__ import annotations

import copy
import pickle
import re
from functools import partial

import gymnasium as gym
import pytest
from gymnasium.wrappers import FilterObservation

import stkzoo
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import kart_action_space
from stkzoo.views import SHIPPED, VIEWS, View, base_space, extras_for, find_view, options_of
from stkzoo.views.agent_chain import AgentChain
from stkzoo.wrappers import ConstantSizedObservations, FlattenerWrapper
from stkzoo.wrappers.marl import PartialObservations
from tests.support.paths import ROOT

#: For each option of the shipped views, a value that is not its default.
OTHERS = {
    "state_items": 3,
    "state_karts": 2,
    "state_paths": 7,
    "add_mask": True,
    "karts_motion": True,
    "acceleration_steps": 3,
    "steer_steps": 5,
    "flatten_observations": False,
    "control_input": ["accl", "steering_speed"],
    "normalize_act": True,
    "buttons": ["nitro"],
    "params": {"v_max": 20.0},
    "kart": "gnu",
    "step_size": 0.05,
}
COMPILED = [view for view in SHIPPED if "camera" not in view.needs]
CASES = [
    (view.name, option)
    for view in COMPILED
    for option in options_of(view)
    # Wrappers around the flattener need flat observations.
    if option != "flatten_observations" or view.wrappers[-1].__name__.startswith("Flatten")
]


def chain_of(choice):
    view = find_view(choice)
    return AgentChain("kart_0", base_space(view), kart_action_space(), view)


def near(env, *, radius=30.0):
    """A user-defined view with an option."""
    return ConstantSizedObservations(PartialObservations(env, radius=radius))


@pytest.fixture
def near_view():
    stkzoo.register_view("near", near)
    yield "near"
    forget("near")


def forget(name):
    del VIEWS[name], gym.registry[f"supertuxkart/{name}-v0"]


@pytest.mark.parametrize(("name", "option"), CASES)
def test_an_option_reaches_its_wrapper_and_the_view_stays_compiled(name, option):
    usual, other = chain_of(name), chain_of((name, {option: OTHERS[option]}))
    plans = [chain.compile().identity() for chain in (usual, other)]
    if option == "normalize_act" and name == "flattened_control":
        assert plans[0] == plans[1]  # the default of this view
    else:
        assert plans[0] != plans[1]
    assert other.is_empty


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("simpel", "unknown view 'simpel'. Did you mean 'simple'?"),
        (("simpel", {}), "unknown view 'simpel'. Did you mean 'simple'?"),
        (
            ("simple", {"state_itmes": 3}),
            "unknown option 'state_itmes' of the simple view. Did you mean 'state_items'? "
            "Known: add_mask, karts_motion, state_items, state_karts, state_paths.",
        ),
        (("full", {"radius": 3}), "the full view has no options; 'radius' came"),
        (("simple", 3), "options of the simple view is 3, expected a mapping"),
        (("simple", {"state_items": 0}), "state_items is 0, expected a whole number of 1 or more"),
        (("control", {"buttons": "fire"}), "buttons is 'fire', expected some of drift, fire"),
        (("control", {"control_input": "sped"}), "the action has the name 'sped', expected one of"),
        (7, "view is 7, expected a name in stkzoo.views()"),
    ],
)
def test_an_invalid_choice_is_a_one_line_error_with_a_suggestion(choice, message):
    with pytest.raises(ConfigError) as caught:
        chain_of(choice)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_views_with_equal_options_are_equal():
    choice = ("control", {"control_input": ["accl", "steering_speed"]})
    view = find_view(choice)
    assert view == find_view(list(choice)) == pickle.loads(pickle.dumps(view))
    assert hash(view) == hash(copy.deepcopy(view))
    assert view != find_view("control")


def test_options_can_be_given_one_after_another():
    view = find_view((("simple", {"state_items": 3}), {"state_karts": 1}))
    assert view == find_view(("simple", {"state_items": 3, "state_karts": 1}))


@pytest.mark.usefixtures("near_view")
@pytest.mark.parametrize("choice", ["near", near, partial(near, radius=5.0)])
def test_the_parameters_of_a_function_are_its_options(choice):
    wrapped = chain_of((choice, {"radius": 12.0})).env.env
    assert wrapped.radius == 12.0
    with pytest.raises(ConfigError, match=r"option 'angle' of the \w+ view.*Known: radius"):
        chain_of((choice, {"angle": 1.0}))


def test_the_parameters_of_a_class_are_its_options():
    keys = {"filter_keys": ["velocity"]}
    assert list(chain_of((FilterObservation, keys)).observation_space) == ["velocity"]


def test_a_function_with_options_can_request_the_ground():
    def own(env, size=3):
        return ConstantSizedObservations(env, state_items=size)

    own.sees_ground = True
    assert extras_for(find_view((own, {"size": 2}))) == {"ground"}
    assert "ground_kind" in chain_of((own, {"size": 2})).observation_space.spaces


def test_a_view_can_be_made_of_another_view():
    inner = find_view(("simple", {"karts_motion": True}))
    outer = View("outer", "A view around another.", (inner, FlattenerWrapper))
    assert extras_for(outer) == {"motion"}
    chain = chain_of((outer, {"state_karts": 1, "flatten_observations": False}))
    assert chain.observation_space["karts_velocity"].shape == (1, 3)


def test_a_known_view_with_options_can_be_registered():
    stkzoo.register_view("three", ("simple", {"state_items": 3}))
    try:
        assert chain_of("three").observation_space["items_position"].shape == (3, 3)
        four = chain_of(("three", {"state_karts": 4})).observation_space
        assert four["items_position"].shape == (3, 3)
        assert four["karts_position"].shape == (4, 3)
    finally:
        forget("three")


@pytest.mark.usefixtures("near_view")
def test_views_are_listed_by_name():
    known = stkzoo.views()
    assert [*known] == [*VIEWS, "camera"]
    assert known["simple"].description
    known.clear()  # this is a copy
    assert "simple" in stkzoo.views()


def test_views_have_the_options_of_the_reference():
    """These are the options of the reference's wrappers, and ``karts_motion``."""
    own = ("state_items", "state_karts", "state_paths", "add_mask", "karts_motion")
    assert options_of(VIEWS["simple"]) == own
    steps = ("acceleration_steps", "steer_steps")
    flattened = (*own, *steps, "flatten_observations")
    assert options_of(VIEWS["flattened_multidiscrete"]) == flattened
    assert set(options_of(VIEWS["control"])) >= {"control_input", "normalize_act", *own}


def test_the_page_of_views_lists_every_option():
    page = (ROOT / "docs/how-to/views.md").read_text()
    rows = page.partition("| wrapper |")[2].partition("\n\n")[0].splitlines()[2:]
    told = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[2])}
    assert told - {"False", "True"} == {name for view in SHIPPED for name in options_of(view)}
