"""Views to test: one for each mechanism in every run, and all of them in ``make test-all``."""

import pytest
from gymnasium.wrappers import TransformObservation

from stkzoo.views import VIEWS, AgentChains

#: A view with lists, one with a dict, one with flat vectors, and the view of the learned drivers.
MECHANISMS = ("full", "simple", "flattened_discrete", "racing")


def walked(env):
    """A view with a wrapper that does not compile, so it runs agent by agent."""
    env = VIEWS["flattened_discrete"](env)
    return TransformObservation(env, dict, env.observation_space)


def agent_by_agent(monkeypatch):
    """Makes new environments collect values agent by agent, as for wrappers in Python."""
    never = property(lambda race: False, lambda race, value: None)  # noqa: ARG005
    monkeypatch.setattr(AgentChains, "has_rows", never, raising=False)


def marked(values, kept):
    """Returns values for ``parametrize``; only ``make test-all`` runs those that are not kept."""
    return [value if value in kept else _only_in_test_all(value) for value in values]


def _only_in_test_all(value):
    values = value if isinstance(value, tuple) else (value,)
    return pytest.param(*values, marks=pytest.mark.matrix)


def id_of(view):
    return f"supertuxkart/{view}-v0"


EACH_ID = marked([*map(id_of, VIEWS)], [*map(id_of, MECHANISMS)])
BUILT_IN = marked(tuple(VIEWS), MECHANISMS)
each_view = pytest.mark.parametrize("view", BUILT_IN)
each_view_and_a_walked_one = pytest.mark.parametrize("view", [*BUILT_IN, walked])
