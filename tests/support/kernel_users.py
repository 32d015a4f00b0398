"""Replaces the kernel's names in the modules that use them."""

import contextlib
import importlib

from stkzoo.engine.track import decode_track
from stkzoo.wrappers.racing import road_observer

#: The modules that use the kernel's names.
USERS = {
    "engine.track": ["TrackGraph"],
    "env.episode": ["StepScorer", "observe_standing", "split_batch"],
    "env.race": ["split_batch"],
    "env.vec.slots": ["new_batch"],
    "mdp.events": ["EventCounter"],
    "wrappers.marl.observations": ["action_mask"],
    "drivers.messages": ["join_rows"],
    "views.chains": ["new_batch", "split_batch"],
    "views.plan": ["ActionReader", "KartObserver"],
    "wrappers.control.car_action": ["CarController"],
    "wrappers.observations": ["to_polar"],
    "wrappers.racing.surroundings": [
        *("join_rows", "look_around", "observe_racing", "trace_roads", "write_racing_view"),
    ],
}


@contextlib.contextmanager
def replaced_kernel(patch, replacements):
    """Makes new objects use other classes and functions, by name, instead of the kernel's."""
    _forget_objects()
    for user, names in USERS.items():
        importlib.import_module(f"stkzoo.{user}")
        for name in replacements.keys() & set(names):
            patch.setattr(f"stkzoo.{user}.{name}", replacements[name])
    yield
    _forget_objects()


def _forget_objects():
    for cache in (decode_track, road_observer):
        cache.cache_clear()
