"""Environments without a game, for tests of wrappers."""

from __future__ import annotations

import importlib
import warnings
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.names import AttachmentType, ItemType, Phase, PowerupType
from stkzoo.views.actions import read_action
from stkzoo.views.chains import RecordsObserver
from stkzoo.views.plan import Seats, ViewPlan
from stkzoo.wrappers import (
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)

#: Wrappers of each registered view, innermost first.
VIEWS = {
    "full": (),
    "simple": (ConstantSizedObservations, PolarObservations),
    "flattened": (ConstantSizedObservations, PolarObservations, FlattenerWrapper),
    "flattened_continuous_actions": (
        ConstantSizedObservations,
        PolarObservations,
        OnlyContinuousActionsWrapper,
        FlattenerWrapper,
    ),
    "flattened_multidiscrete": (
        ConstantSizedObservations,
        PolarObservations,
        DiscreteActionsWrapper,
        FlattenerWrapper,
    ),
    "flattened_discrete": (
        ConstantSizedObservations,
        PolarObservations,
        DiscreteActionsWrapper,
        FlattenerWrapper,
        FlattenMultiDiscreteActions,
    ),
}


def import_reference(module):
    """Imports a module of the reference, then restores stkzoo's ids, which the import replaces."""
    ids = dict(gym.registry)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        imported = importlib.import_module(f"pystk2_gymnasium.{module}")
    gym.registry.update(ids)
    return imported


def wrap(env, view):
    for wrapper in VIEWS[view]:
        env = wrapper(env)
    return env


def wrap_as_reference(env, view):
    """Wraps like :func:`wrap`, but with the reference's wrappers."""
    modules = [import_reference("stk_wrappers"), import_reference("wrappers")]
    for wrapper in VIEWS[view]:
        name = wrapper.__name__
        module = next(module for module in modules if hasattr(module, name))
        env = getattr(module, name)(env)
    return env


class ScriptedEnv(gym.Env):
    """An environment that returns the results of the given functions."""

    def __init__(self, observation_space, action_space, reset=None, step=None):
        self.observation_space = observation_space
        self.action_space = action_space
        self._reset = reset
        self._step = step

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        super().reset(seed=seed)
        return self._reset()

    def step(self, action):
        return self._step(action)


def kart_env(use_ai=False):
    """Returns an environment for one kart, with spaces only."""
    return ScriptedEnv(kart_observation_space(use_ai), kart_action_space())


def number_env(steps=3):
    """Returns an environment that observes its number of steps and ends after ``steps``."""
    count = 0

    def reset():
        nonlocal count
        count = 0
        return np.zeros(1, np.float32), {}

    def step(action):
        nonlocal count
        count += 1
        return np.full(1, count, np.float32), float(action), count >= steps, False, {}

    box = spaces.Box(0, 100, (1,), np.float32)
    return ScriptedEnv(box, spaces.Discrete(3), reset, step)


def split(space, batch):
    """Returns the rows of a batch in Gymnasium's format."""
    if isinstance(space, spaces.Dict):
        columns = [split(part, batch[key]) for key, part in space.spaces.items()]
        return [dict(zip(space.spaces, row, strict=True)) for row in zip(*columns, strict=True)]
    if isinstance(space, (spaces.Discrete, spaces.Text)):
        return np.asarray(batch).tolist()
    if isinstance(space, spaces.Sequence):
        return [tuple(row) for row in np.array(batch)]
    return list(np.array(batch))


def random_batch(rng, count, *, items=7, karts=4, paths=9, use_ai=False):
    """Returns random full observations of ``count`` agents as a batch."""
    lengths = {"items": items, "karts": karts, "paths": paths}

    def column(key, space):
        if isinstance(space, spaces.Dict):
            return {name: column(name, part) for name, part in space.spaces.items()}
        if isinstance(space, spaces.Text):
            return np.array(rng.choice(["tux", "gnu", "sara_the_racer"], count))
        if isinstance(space, spaces.Discrete):
            return rng.integers(space.n, size=count)
        if isinstance(space, spaces.Sequence):
            size = (count, lengths[key.split("_")[0]])
            part = space.feature_space
            if isinstance(part, spaces.Discrete):
                return rng.integers(part.n, size=size)
            numbers = rng.normal(scale=30, size=(*size, *part.shape)).astype(np.float32)
            return np.maximum(numbers, part.low)
        numbers = rng.normal(scale=1, size=(count, *space.shape)).astype(np.float32)
        return np.clip(numbers, space.low, space.high)

    return column("", kart_observation_space(use_ai))


class RandomMoment:
    """A random snapshot of karts and items on a small circular track, which can be observed."""

    step_size = 0.1

    def __init__(self, rng, num_kart=5, num_items=7, num_nodes=9):
        karts, items = np.zeros(num_kart, KART_DTYPE), np.zeros(num_items, ITEM_DTYPE)
        for things in (karts, items):
            things["location"] = rng.normal(scale=30, size=(len(things), 3))
        turns = rng.normal(size=(num_kart, 4))
        karts["rotation"] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        karts["front"] = karts["location"] + 1
        karts["velocity_lc"] = rng.normal(scale=9, size=(num_kart, 3))
        for key in ("energy", "skeed_factor", "shield_time", "attachment_time_left"):
            karts[key] = rng.integers(0, 9, num_kart)
        karts["max_steer_angle"] = rng.uniform(0, 1, num_kart)
        karts["distance_down_track"] = rng.uniform(0, 99, num_kart)
        for key, kind in (("powerup_type", PowerupType), ("attachment_type", AttachmentType)):
            karts[key] = rng.choice(list(kind), num_kart)
        karts["powerup_num"] = rng.integers(0, 20, num_kart)
        karts["jumping"] = rng.integers(0, 2, num_kart)
        karts["node"] = rng.integers(0, num_nodes, num_kart)
        karts["control"] = rng.integers(0, 2, (num_kart, 7))
        items["type"] = rng.choice(list(ItemType), num_items)
        header = np.zeros((), HEADER_DTYPE)
        header["aux_ticks"], header["phase"] = rng.integers(0, 99), rng.choice(list(Phase))
        self.snapshot = Snapshot.of(header, karts, items)
        corners = rng.normal(scale=30, size=(num_nodes, 3)).astype(np.float32)
        self.track_map = TrackMap(
            length=10.0 * num_nodes,
            path_nodes=np.stack([corners, np.roll(corners, -1, axis=0)], axis=1),
            path_width=rng.uniform(2, 9, (num_nodes, 1)).astype(np.float32),
            path_distance=np.arange(2 * num_nodes, dtype=np.float32).reshape(-1, 2) * 5,
            successors=[[(node + 1) % num_nodes] for node in range(num_nodes)],
        )
        kart_types = tuple(rng.choice(["tux", "gnu", "sara_the_racer"], num_kart).tolist())
        self.course = self.track_map.graph, num_nodes, kart_types

    def seats(self, agents):
        places = np.arange(len(agents))
        return Seats(tuple(agents), karts=places, rows=places, num_rows=len(agents), numbers=places)

    def full(self, agents, use_ai=False):
        """Returns the agents' observations in the ``full`` view."""
        return observe_full(self, self.seats(agents).karts, use_ai)


def observe_full(source, karts, use_ai=False):
    """Returns the observation of each kart in the ``full`` view."""
    plan = ViewPlan(kart_observation_space(use_ai))
    return RecordsObserver(plan).observe(source, np.asarray(karts))


def full_views(env):
    """Returns the observations of the racing agents in the ``full`` view."""
    episode = env.live_race.episode
    return observe_full(episode, episode.seats(env.agents).karts)


def moment_of(snapshot, track, kart_types, num_paths=None):
    """Returns a moment of a race that can be observed."""
    paths = track.num_nodes if num_paths is None else num_paths
    course = track.graph, paths, tuple(kart_types)
    return SimpleNamespace(snapshot=snapshot, track_map=track, course=course)


def assert_same(left, right):
    """Asserts equal keys, types, dtypes and shapes, and nearly equal values."""
    if isinstance(right, dict):
        assert left.keys() == right.keys()
        for key in right:
            assert_same(left[key], right[key])
    elif isinstance(right, tuple):
        assert isinstance(left, tuple)
        assert len(left) == len(right)
        for one, other in zip(left, right, strict=True):
            assert_same(one, other)
    elif isinstance(right, np.ndarray):
        assert isinstance(left, np.ndarray)
        assert left.dtype == right.dtype
        assert left.shape == right.shape
        np.testing.assert_allclose(left, right, rtol=1e-6, atol=0)
    else:
        assert type(left) is type(right)
        assert left == right


class SmallRace(ParallelEnv):
    """A parallel environment without a game. Agent ``n`` finishes after ``ends[n]`` steps."""

    metadata = {"name": "small_race", "render_modes": []}  # noqa: RUF012
    render_mode = None

    def __init__(self, ends=(3, 5)):
        self.ends = ends
        self.possible_agents = [f"kart_{number}" for number in range(len(ends))]
        self.agents = []
        self.last_actions = None
        self._spaces = {
            agent: (kart_observation_space(), kart_action_space()) for agent in self.possible_agents
        }

    def observation_space(self, agent):
        return self._spaces[agent][0]

    def action_space(self, agent):
        return self._spaces[agent][1]

    def _observe(self, agents):
        return {
            agent: split(self._spaces[agent][0], random_batch(self._rng, 1))[0] for agent in agents
        }

    def reset(self, seed=None, options=None):  # noqa: ARG002
        self._rng = np.random.default_rng(seed)
        self.agents = list(self.possible_agents)
        self.steps = 0
        return self._observe(self.agents), {agent: {"position": 1} for agent in self.agents}

    def step(self, actions):
        acted = self.agents
        for agent in acted:
            read_action(self.action_space(agent), actions[agent], agent)
        self.last_actions = actions
        self.steps += 1
        ended = {
            agent: self.steps >= end
            for agent, end in zip(self.possible_agents, self.ends, strict=True)
            if agent in acted
        }
        self.agents = [agent for agent in acted if not ended[agent]]
        return (
            self._observe(acted),
            dict.fromkeys(acted, 1.0),
            ended,
            dict.fromkeys(acted, False),
            {agent: {"position": 1} for agent in acted},
        )


class MultiEnv(gym.Env):
    """A :class:`SmallRace` as a Gymnasium environment of dicts, which leave out finished agents."""

    def __init__(self, ends=(3, 5)):
        self.race = SmallRace(ends)
        agents = self.race.possible_agents
        self.numbers = {agent: str(number) for number, agent in enumerate(agents)}
        self.observation_space = spaces.Dict(
            {self.numbers[agent]: self.race.observation_space(agent) for agent in agents}
        )
        self.action_space = spaces.Dict(
            {self.numbers[agent]: self.race.action_space(agent) for agent in agents}
        )

    def _numbered(self, values):
        return {self.numbers[agent]: value for agent, value in values.items()}

    def reset(self, *, seed=None, options=None):  # noqa: ARG002
        super().reset(seed=seed)
        observations, infos = self.race.reset(seed)
        self.last_observations = self._numbered(observations)
        return self.last_observations, {"infos": self._numbered(infos)}

    def step(self, actions):
        agents = {number: agent for agent, number in self.numbers.items()}
        observations, rewards, ends, _, infos = self.race.step(
            {agents[number]: action for number, action in actions.items()}
        )
        self.last_observations = self._numbered(observations)
        info = {
            "reward": self._numbered(rewards),
            "terminated": self._numbered(ends),
            "infos": self._numbered(infos),
        }
        done = not self.race.agents
        return self.last_observations, sum(rewards.values()), done, False, info


class Counter(gym.ObservationWrapper):
    """Observes the number of observations since the last reset."""

    def __init__(self, env):
        super().__init__(env)
        self.observation_space = spaces.Discrete(1000)
        self.count = 0

    def reset(self, *, seed=None, options=None):
        self.count = 0
        return super().reset(seed=seed, options=options)

    def observation(self, _):
        self.count += 1
        return self.count
