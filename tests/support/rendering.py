"""Helpers for tests of rendering."""

import functools

import numpy as np

from stkzoo import race_v0
from stkzoo.engine.assets import find_assets
from stkzoo.engine.render_session import check_graphics_libraries
from stkzoo.errors import AssetError, ConfigError


@functools.cache
def who_draws():
    """Returns the backend of ``render_backend="auto"`` on this machine."""
    try:
        check_graphics_libraries()
        find_assets(graphics=True)
    except (AssetError, ConfigError):
        return "map"
    return "engine"


def drive(env, steps, seed=1):
    """Drives at full throttle with a little steering; yields after the reset and each step."""
    env.reset(seed=seed)
    yield env
    random = np.random.default_rng(seed)
    for _ in range(steps):
        actions = {}
        for agent in env.agents:
            space = env.action_space(agent)
            action = {
                name: type(part.sample())(0) if part.shape == () else part.low * 0
                for name, part in space.spaces.items()
            }
            action["acceleration"] = np.ones(1, np.float32)
            action["steer"] = random.uniform(-0.2, 0.2, 1).astype(np.float32)
            actions[agent] = action
        env.step(actions)
        yield env


def small_race(**options):
    """Returns an environment with three karts on a short track."""
    return race_v0.parallel_env(num_kart=3, track="lighthouse", **options)


def frames_of(env):
    """Returns the frame of each agent with a camera, in any render mode."""
    renderer = env.live_race.rendering._renderer
    renderer.follow(env.scene)
    by_kart = renderer.pictures(env.snapshot)
    karts = zip(env.live_race.possible_agents, env.race.kart_indices, strict=True)
    return {agent: by_kart[kart] for agent, kart in karts if kart in by_kart}


def history(steps=40, **options):
    """Returns all snapshots of a small race as bytes."""
    with small_race(**options) as env:
        moments = []
        for now in drive(env, steps):
            moments.append(now.snapshot.data)
            if options.get("render_mode") == "rgb_array" and len(moments) % 20 == 0:
                now.render()
        return moments
