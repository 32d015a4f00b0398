"""Plays races of parallel environments, and compares them bit by bit."""

import copy
import hashlib
from collections.abc import Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field

import numpy as np
from gymnasium import spaces

from stkzoo.mdp.spaces import action_of

PARTS = ("observations", "rewards", "terminations", "truncations", "infos")


@contextmanager
def vector_maker(env_type, **defaults):
    """Yields a function that makes vector environments, which are closed at the end."""
    with ExitStack() as stack:

        def make(num_races=2, **options):
            return stack.enter_context(closing(env_type(num_races, **defaults | options)))

        yield make


@dataclass(frozen=True)
class Step:
    """One ``reset`` (number 0) or ``step``: who acted, what it returned, and who still races."""

    number: int
    acting: tuple
    actions: dict
    observations: dict
    rewards: dict = field(default_factory=dict)
    terminations: dict = field(default_factory=dict)
    truncations: dict = field(default_factory=dict)
    infos: dict = field(default_factory=dict)
    agents: tuple = ()

    @property
    def parts(self):
        """The results by name."""
        names = PARTS if self.number else ("observations", "infos")
        return {name: getattr(self, name) for name in names}

    def is_end_of(self, agent):
        return self.terminations.get(agent, False) or self.truncations.get(agent, False)


class RandomPolicy:
    """Samples actions from seeded copies of the action spaces, also for agents that have left."""

    def __init__(self, env, seed=0, with_departed=False):
        self._with_departed = with_departed
        self._spaces = {}
        for number, agent in enumerate(env.possible_agents):
            self._spaces[agent] = copy.deepcopy(env.action_space(agent))
            self._spaces[agent].seed(1000 * seed + number)

    def __call__(self, step):
        agents = self._spaces if self._with_departed else step.agents
        return {agent: self._spaces[agent].sample() for agent in agents}


def kart_action(throttle=0.0, steer=0.0, **buttons):
    """Returns an action of the ``full`` view. Buttons are released unless they are given."""
    return action_of(np.array([throttle, steer, 0, 0, 0, 0, 0], np.float32)) | buttons


def play(env, seed, *, max_steps=None, policy=None, options=None):
    """Yields the reset and the steps of a race, up to its end or for some steps."""
    policy = policy or RandomPolicy(env)
    observations, infos = env.reset(seed=seed, options=options)
    agents = tuple(env.agents)
    step = Step(0, agents, {}, observations, infos=infos, agents=agents)
    yield step
    while step.agents and step.number != max_steps:
        actions = policy(step)
        parts = dict(zip(PARTS, env.step(dict(actions)), strict=True))
        step = Step(step.number + 1, step.agents, actions, agents=tuple(env.agents), **parts)
        yield step


def trace(steps):
    """Returns the fingerprints of each step's results, by part and agent."""
    return [
        {name: {a: fingerprint(v) for a, v in part.items()} for name, part in step.parts.items()}
        for step in steps
    ]


def fingerprint(value):
    """Returns a hash of a value's types and bits, including those of nested containers."""
    digest = hashlib.blake2b(digest_size=8)
    _hash(value, digest.update)
    return digest.hexdigest()


def _hash(value, update):
    name = type(value).__name__
    if isinstance(value, np.ndarray) and value.dtype == object:
        _hash(value.tolist(), update)
    elif isinstance(value, (np.ndarray, np.generic)):
        update(f"{name} {value.dtype.str} {value.shape} ".encode() + value.tobytes())
    elif isinstance(value, Mapping):
        update(f"{name} {len(value)} ".encode())
        for pair in value.items():
            _hash(pair, update)
    elif isinstance(value, (tuple, list)):
        update(f"{name} {len(value)} ".encode())
        for entry in [np.array(value)] if are_alike(value) else value:  # faster than one by one
            _hash(entry, update)
    else:
        update(f"{name} {value!r} ".encode())


def are_alike(values):
    """Returns whether there are values, all plain arrays of one dtype and shape."""
    kinds = {(type(v), getattr(v, "dtype", None), getattr(v, "shape", None)) for v in values}
    return len(kinds) == 1 and next(iter(kinds))[0] is np.ndarray


def assert_in(space, value, path):
    """Like ``assert space.contains(value)``, but with equal dtypes and the path of what differs."""
    if isinstance(space, spaces.Dict):
        assert value.keys() == space.spaces.keys(), path
        for key, part in space.spaces.items():
            assert_in(part, value[key], f"{path}[{key!r}]")
    elif isinstance(space, spaces.Sequence):
        assert isinstance(value, tuple), path
        if are_alike(value) and type(space.feature_space) is spaces.Box:
            _assert_in_box(space.feature_space, value, path)
        else:
            for number, entry in enumerate(value):
                assert_in(space.feature_space, entry, f"{path}[{number}]")
    else:
        assert space.contains(value), f"{path} is {value!r}, expected a value of {space}"
        assert getattr(value, "dtype", space.dtype) == space.dtype, path


def _assert_in_box(box, entries, path):
    rows = np.array(entries)
    assert (rows.dtype, rows.shape[1:]) == (box.dtype, box.shape), path
    assert ((rows >= box.low) & (rows <= box.high)).all(), path


def arrays_in(value, path=""):
    """Yields all arrays in nested dicts, tuples and lists, with their paths."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from arrays_in(entry, f"{path}[{key!r}]")
    elif isinstance(value, (tuple, list)):
        for number, entry in enumerate(value):
            yield from arrays_in(entry, f"{path}[{number}]")
