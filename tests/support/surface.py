"""The surface of pystk2-gymnasium: the names in its modules, and the attributes of its objects.

It runs in programs of its own, with pystk2-gymnasium and with ``stkzoo.compat``.
"""

import contextlib
import importlib
import inspect
import pkgutil

import gymnasium as gym
import pystk2_gymnasium as package
from pystk2_gymnasium import (
    AgentSpec,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    MonoAgentWrapperAdapter,
    PolarObservations,
)
from pystk2_gymnasium.stk_wrappers import OnlyContinuousActionsWrapper


def public(names):
    return [name for name in names if not name.startswith("_")]


def names():
    """Yields the dotted names of all that the reference's modules define or import of pystk2."""
    yield from (name for name, value in vars(package).items() if inspect.isclass(value))
    yield "register"
    for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        module, short = importlib.import_module(info.name), info.name.partition(".")[2]
        for name in public(vars(module)):
            value = getattr(module, name)
            if getattr(value, "__module__", "").startswith("pystk2"):
                yield f"{short}.{name}"
                yield from (f"{short}.{name}{part}" for part in parts(value, module))


def parts(value, module):
    """Yields the parameters and the members of a function or class."""
    if value.__module__ == module.__name__:
        with contextlib.suppress(ValueError):  # an exception without a constructor
            parameters = inspect.signature(value).parameters.values()
            yield from (f"({each.name})" for each in parameters if each.kind != each.VAR_KEYWORD)
    for kind in inspect.getmro(value) if inspect.isclass(value) else ():
        if kind.__module__.startswith("pystk2_"):
            yield from (f".{name}" for name in public(vars(kind)))


def objects():
    """Returns the objects that users meet in a race, by name."""
    race = {"num_kart": 2, "track": "lighthouse"}
    single = gym.make("supertuxkart/full-v0", **race)
    multi = gym.make("supertuxkart/multi-full-v0", agents=[AgentSpec()], **race)
    adapter = MonoAgentWrapperAdapter(multi, wrapper_factories={"0": PolarObservations})
    for env in (single, adapter):
        env.reset(seed=1)
        env.step(env.action_space.sample())
    constant = ConstantSizedObservations(single)
    discrete = DiscreteActionsWrapper(constant)
    flat = FlattenerWrapper(discrete)
    env = single.unwrapped
    kart = env.world.karts[0]
    met = {
        "env": env,
        "multi": multi.unwrapped,
        "adapter": adapter,
        "world": env.world,
        "player": env.world.players[0],
        "kart": kart,
        "item": env.world.items[0],
        "powerup": kart.powerup,
        "attachment": kart.attachment,
        "track": env.track,
        "config": env.config,
        "config_player": env.config.players[0],
        "spec": AgentSpec(),
        "constant": constant,
        "polar": PolarObservations(constant),
        "discrete": discrete,
        "continuous": OnlyContinuousActionsWrapper(constant),
        "discretizer": discrete.d_steer,
        "flat": flat,
        "flattener": flat.action_flattener,
        "choices": FlattenMultiDiscreteActions(flat),
    }
    multi.close()
    single.close()
    return met


def attributes():
    """Yields the attributes of the objects."""
    for name, value in objects().items():
        found = vars(value) if hasattr(value, "__dict__") else dir(value)
        yield from (f"{name}.{attribute}" for attribute in public(found))


def missing(paths):
    """Yields each path that does not exist, its missing name, and what the error says of it."""
    met = objects()
    for path in paths:
        head, *tail = path.partition("(")[0].split(".")
        value = met.get(head, package)
        for name in tail if head in met else (head, *tail):
            hints = getattr(value, "left_out", {}) if inspect.isclass(value) else {}
            try:
                value = getattr(value, name)
            except (AttributeError, ImportError) as error:
                yield path, name, hints.get(name) or str(error)
                break
        else:
            parameter = path.partition("(")[2].rstrip(")")
            accepted = inspect.signature(value).parameters.values() if parameter else ()
            if parameter and not any(
                each.name == parameter or each.kind is each.VAR_KEYWORD for each in accepted
            ):
                yield path, parameter, "no such parameter"
