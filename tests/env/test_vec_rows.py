"""The kernel writes the same values into slot arrays as it returns for single agents."""

import os
import signal

import numpy as np
import pytest
from gymnasium.wrappers import RescaleAction

from stkzoo import ActionError, AgentSpec, RaceVectorEnv, Start
from stkzoo.views import VIEWS
from tests.env.test_vec import pids, same
from tests.support.views import MECHANISMS, agent_by_agent, marked

#: The first kart finishes after a few steps. The second is truncated later, so slot 0 idles.
STARTS = {"kart_0": Start(share=0.998, speed=20.0), "kart_1": Start(distance=50.0)}
OPTIONS = {"num_kart": 3, "agents": 2, "track": "lighthouse", "max_cycles": 9, "prefetch": False}
OPTIONS["start"] = STARTS
NUM_STEPS = 12
FIXED = [name for name in VIEWS if name not in ("full", "ground")]
SIZES = {"state_items": 3, "state_karts": 1, "state_paths": 7, "add_mask": True}
VARIED = [
    ("simple", SIZES),
    pytest.param(("simple", {"karts_motion": True}), marks=pytest.mark.matrix),
    pytest.param(("flattened", SIZES), marks=pytest.mark.matrix),
    pytest.param(("box_discrete", SIZES | {"steer_steps": 3}), marks=pytest.mark.matrix),
]


@pytest.fixture(params=[True, False], ids=["rows", "agents"])
def _each_form(request, monkeypatch):
    if not request.param:
        agent_by_agent(monkeypatch)


def play(num_steps=NUM_STEPS, kill_at=None, options_later=None, **options):
    """Returns everything that an environment returns, and whether it uses rows."""
    envs = RaceVectorEnv(2, **{**OPTIONS, **options})
    try:
        trace = [envs.reset(seed=1)]
        envs.action_space.seed(5)
        envs.set_options(options_later)
        for step in range(num_steps):
            if step == kill_at:
                os.kill(pids(envs)[0], signal.SIGKILL)
            trace.append((*envs.step(envs.action_space.sample()), envs.racing))
        return trace, envs.races[0].live_race.chains.has_rows
    finally:
        envs.close()


def both(monkeypatch, **options):
    """Returns the results with rows, after comparing them with those collected by agent."""
    trace, has_rows = play(**options)
    agent_by_agent(monkeypatch)
    expected, has_none = play(**options)
    assert (has_rows, has_none) == (True, False)
    assert same(trace, expected)
    return trace


# ---------------------------------------------------------------------- the same values


@pytest.mark.slow
@pytest.mark.parametrize("view", [*marked(FIXED, MECHANISMS), *VARIED], ids=str)
def test_rows_equal_the_values_of_single_agents(view, monkeypatch):
    trace = both(monkeypatch, view=view)
    active = np.array([step[4]["active"] for step in trace[1:]])
    ends, cuts = (np.array([step[number] for step in trace[1:]]) for number in (2, 3))
    assert ends.any()
    assert cuts.any()
    assert not active.all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"end_when_stuck": 0.5, "events": True},
        {"reward": {"mine": lambda step: step.distance}},
        {"reward": {"kart_0": "race", "kart_1": {"mine": lambda step: step.distance}}},
        {"opponents": ["pursuit"], "view": "racing"},
        {"max_paths": 4, "view": "racing"},
        {"agents": [AgentSpec(use_ai=True)] * 2, "view": "simple"},
        {"view": {"kart_0": "box_discrete", "kart_1": ("box_discrete", {"state_items": 5})}},
    ],
    ids=lambda options: next(iter(options)),
)
def test_rows_are_used_with_every_option(options, monkeypatch):
    both(monkeypatch, **options)


@pytest.mark.slow
def test_races_with_other_infos_share_the_columns(monkeypatch):
    trace = both(monkeypatch, options_later=[{"events": True}, None])
    infos = trace[-1][4]
    assert infos["_event/off_road"].tolist() == [True, True, False, False]
    assert infos["_position"].any()
    assert (infos["position"] > 0).tolist() == infos["_position"].tolist()


def test_a_crash_ends_slots_at_their_last_observation(monkeypatch):
    trace = both(monkeypatch, num_steps=6, kill_at=2, view="box_discrete", start=None)
    infos = trace[3][4]
    assert infos["crashed"].tolist() == [True, True, False, False]
    for slot in range(2):
        assert infos["final_obs"][slot].tobytes() == trace[2][0][slot].tobytes()
        assert infos["final_info"]["distance"][slot] == trace[2][4]["distance"][slot]


@pytest.mark.usefixtures("_each_form")
def test_whole_numbers_in_infos_have_integer_dtypes():
    infos = play(2)[0][-1][4]
    whole = {key for key, value in infos.items() if value.dtype == np.int64 and key[0] != "_"}
    assert whole == {"position", "lap", "episode/length", "track"}


def test_arrays_of_a_step_are_not_changed_by_later_steps():
    envs = RaceVectorEnv(2, **OPTIONS, view="simple")
    envs.reset(seed=1)
    kept, copies = [], []
    for _ in range(NUM_STEPS):
        observations, *flags, infos = envs.step(envs.action_space.sample())
        arrays = [*observations.values(), *flags, *infos.values()]
        arrays = [array for array in arrays if isinstance(array, np.ndarray)]
        kept.append(arrays)
        copies.append([array.copy() for array in arrays])
    envs.close()
    assert all(map(same, kept, copies))


# ---------------------------------------------------------------------- rows or agents


def rescaled(env):
    return RescaleAction(VIEWS["box_continuous"](env), np.float32(0), np.float32(1))


@pytest.mark.parametrize(
    "options",
    [
        {"view": rescaled},
        {"view": {"kart_0": rescaled, "kart_1": rescaled}},
    ],
    ids=["all", "each"],
)
def test_other_views_are_collected_agent_by_agent(options):
    trace, has_rows = play(3, **{"start": None, **options})
    assert not has_rows
    assert trace[-1][4]["active"].all()


# ---------------------------------------------------------------------- actions


def unusual(actions):
    """Yields the same actions in other valid forms."""
    yield {key: value.tolist() for key, value in actions.items()}
    yield {key: np.repeat(value, 2, axis=-1)[..., ::2] for key, value in actions.items()}
    yield actions | {"discrete": actions["discrete"].astype(np.float64)}
    yield actions | {"discrete": actions["discrete"].astype(np.uint8)}
    yield actions | {"horn": np.ones(4)}


@pytest.mark.slow
@pytest.mark.usefixtures("_each_form")
def test_all_forms_of_an_action_have_the_same_effect():
    envs = RaceVectorEnv(2, **OPTIONS, view="flattened")
    envs.action_space.seed(3)
    actions = envs.action_space.sample()
    results = []
    for form in (actions, *unusual(actions)):
        envs.reset(seed=1)
        results.append([envs.step(form) for _ in range(2)])
    envs.close()
    assert all(same(result, results[0]) for result in results[1:])


def wrong(actions):
    """Yields invalid actions, each with a text that the error contains."""
    for bad in (np.nan, 2.0, -np.inf):
        continuous = actions["continuous"].copy()
        continuous[3, 1] = bad
        yield actions | {"continuous": continuous}, "kart_1 of race 1"
    discrete = actions["discrete"].copy()
    discrete[2, 0] = 7
    yield actions | {"discrete": discrete}, "kart_0 of race 1"
    yield actions | {"discrete": discrete.astype(object)}, "kart_0 of race 0"
    yield actions | {"discrete": actions["discrete"] + 0.5}, "kart_0 of race 0"
    yield actions | {"discrete": actions["discrete"][:, :2]}, "kart_0 of race 0"
    yield {key: value[:3] for key, value in actions.items()}, "4 slots"
    yield {"continuous": actions["continuous"]}, "4 slots"
    yield actions["continuous"], "4 slots"


@pytest.mark.usefixtures("_each_form")
def test_an_invalid_action_is_an_error_before_any_race_advances():
    envs = RaceVectorEnv(2, **OPTIONS | {"start": None}, view="flattened")
    actions = envs.action_space.sample()
    envs.reset(seed=1)
    for bad, named in wrong(actions):
        with pytest.raises(ActionError, match=named):
            envs.step(bad)
    assert envs.step(actions)[4]["episode/length"].tolist() == [1] * 4
    envs.close()


@pytest.mark.usefixtures("_each_form")
def test_a_rejected_batch_does_not_turn_the_wheels():
    envs = RaceVectorEnv(2, **OPTIONS | {"start": None}, view="flattened_control")
    full_left = np.tile(np.float32([-1.0, 0.5]), (4, 1))
    full_right = -full_left
    full_left[3, 0] = np.nan
    traces = []
    for rejected in ([], [full_left] * 3):
        trace = [envs.reset(seed=1)]
        for bad in rejected:
            with pytest.raises(ActionError, match="kart_1 of race 1"):
                envs.step(bad)
        trace.extend(envs.step(full_right) for _ in range(3))
        traces.append(trace)
    envs.close()
    assert same(*traces)


@pytest.mark.usefixtures("_each_form")
def test_actions_of_idle_slots_are_ignored():
    envs = RaceVectorEnv(2, **OPTIONS, view="flattened_discrete")
    envs.reset(seed=1)
    while envs.racing.all():
        envs.step(np.zeros(4, np.int64))
    actions = np.where(envs.racing, 0, 10**6)
    active = envs.racing
    assert np.array_equal(envs.step(actions)[4]["active"], active)
    envs.close()
