"""Create a starter agent.

Writes a small commented driver to a new folder, as a starting point for your own, and a README.md
with the next steps. The driver finishes easy tracks such as lighthouse. With a view other than
simple, its actions are random until you add a policy. Existing files are never overwritten.

Examples:
  stkzoo new my_agent                create my_agent/pystk_actor.py
  stkzoo new my_agent --view racing  for a policy that you train on this view
  stkzoo race my_agent ai ai         race it against the game's AI
  stkzoo check my_agent              see whether a tournament would accept it
"""

from __future__ import annotations

import argparse
import json
import shlex
from dataclasses import dataclass
from pathlib import Path

from stkzoo._arguments import CommandParser, add_options, option, positional
from stkzoo._os import write_text
from stkzoo._schema import plain_text
from stkzoo.cli._arguments import usage_errors
from stkzoo.errors import ConfigError

_ACTOR = '''\
"""A starter agent. Its contract is described in docs/reference/agents.md."""

import numpy as np

# The view: what the agent observes and how it acts. Other views have other keys and shapes.
env_name = "supertuxkart/simple-v0"

# The name in results.
player_name = {name}


class State:
    """What the agent remembers. Every race starts with a new one."""

    slow_steps = 0


create_state = State


def get_actor(module_dir, observation_space, action_space):
    """Called once before each race. Do slow work here, such as loading weights."""

    def actor(state, observation):
        """Called at every step, ten times per second. Returns one action."""
        # The road ahead as points in front of the kart; index 3 is a few segments away.
        # Each point is (angle [rad], height [m], distance [m]); a positive angle is to the right.
        angle = observation["paths_end"][3][0]

        # A stuck kart can ask to be put back on the road.
        speed = np.linalg.norm(observation["velocity"])  # [m/s]
        state.slow_steps = state.slow_steps + 1 if speed < 1 else 0
        is_stuck = state.slow_steps > 50  # 5 s; the countdown before the start is shorter
        if is_stuck:
            state.slow_steps = 0

        # To see what the agent sees, uncomment this line and race with --show-output.
        # print(f"angle {{angle:.2f}} rad, speed {{speed:.1f}} m/s")

        return {{
            "acceleration": np.array([1.0], np.float32),  # 0 to 1
            "steer": np.array([np.clip(2.5 * angle, -1, 1)], np.float32),  # -1 left to 1 right
            "brake": 0,
            "drift": 0,  # hold in sharp curves to collect a boost
            "fire": 0,  # use the collected item
            "nitro": 1,  # use nitro whenever there is some
            "rescue": int(is_stuck),
        }}

    return actor
'''

_POLICY = '''\
"""A starter agent for a policy. Its contract is described in docs/reference/agents.md."""

# The view: what the agent observes and how it acts. Use the one that you train on.
env_name = "supertuxkart/{view}-v0"

# The name in results.
player_name = {name}


def get_actor(module_dir, observation_space, action_space):
    """Called once before each race. Load your policy here, such as module_dir / "weights.pt"."""

    def actor(state, observation):
        """Called at every step, ten times per second. Returns one action."""
        return action_space.sample()  # a random action: return that of your policy instead

    return actor
'''

_README = """\
# {name}

`pystk_actor.py` is an agent for stkzoo. Next steps: race it, change how it steers, brakes and
uses items, then check it:

    stkzoo race {folder} ai ai --show-output
    stkzoo check {folder}
    python -m zipfile -c {zip} {folder}
"""


@dataclass
class NewArguments:
    """Arguments of ``stkzoo new``.

    Attributes:
        folder: folder to create
        view: view of the agent, such as simple, racing or box_continuous
    """

    folder: str = positional(metavar="FOLDER")
    view: str = option("simple", metavar="NAME")


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    add_options(parser, NewArguments)


@usage_errors
def run(arguments: argparse.Namespace) -> int:
    """Creates the agent and prints what to do next."""
    from stkzoo.drivers.driver import find_driver_view

    find_driver_view(arguments.view)
    _check_name(arguments.folder)
    folder = Path(arguments.folder)
    name = folder.resolve().name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise ConfigError(f"cannot create {arguments.folder!r}: {error.strerror}") from None
    if not is_empty:
        raise ConfigError(f"{arguments.folder!r} is not empty; choose another folder")
    quoted = shlex.quote(arguments.folder)
    archive = shlex.quote(f"{name}.zip")
    actor = _ACTOR if arguments.view == "simple" else _POLICY
    source = actor.format(name=json.dumps(name, ensure_ascii=False), view=arguments.view)
    write_text(folder / "pystk_actor.py", source)
    readme = _README.format(name=name, folder=quoted, zip=archive)
    write_text(folder / "README.md", readme)
    print(f"Created {folder / 'pystk_actor.py'} and README.md. Next:")
    for command, purpose in (
        (f"stkzoo race {quoted} ai ai", "race it against the game's AI"),
        (f"stkzoo check {quoted}", "see what a tournament would say"),
        (f"python -m zipfile -c {archive} {quoted}", "make the zip to hand in"),
    ):
        print(f"  {command}\n      {purpose}")
    return 0


def _check_name(folder: str) -> None:
    """Refuses a folder that files cannot name, or that commands would not accept as an agent."""
    from stkzoo.drivers.driver import driver_names

    path = str(Path(folder).resolve())
    shown = plain_text(path)
    if shown != path:
        raise ConfigError(
            f"the path {shown!r} has control codes or is not UTF-8; choose another folder"
        )
    if "@:" in folder:
        raise ConfigError(
            f"{folder!r} contains @:, which sets a driver's name; choose another folder"
        )
    if folder in driver_names() or folder.startswith(("ai:", "pretrained:")):
        raise ConfigError(f"{folder!r} is the name of a driver of stkzoo; choose another folder")
