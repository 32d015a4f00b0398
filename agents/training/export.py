r"""Exports learned weights as an agent: a folder that you can race and share.

    python -m stkzoo.agents.training.export runs/first/policy-002000000.safetensors \
        --name swift --output agents/pretrained/swift

The weights come from a run of ``ppo``, ``sb3``, ``rllib``, ``imitation`` or ``league``. With
``--ensemble-weight 1``, one or more networks without plans form an ensemble with the plans: the
agent chooses a plan by its value and, with this weight, by its probability under the networks.
Policies over plans can be members too; their learned logits are added to those of the plans. The
folder of an ensemble adds its members. ``--plans FILE`` gives an ensemble other plans.

The folder contains the weights; ``card.json`` with their digest, the training arguments (from
``arguments.json`` beside the weights, if it exists) and, for policies over plans, the parameters of
the plans; and the agent's module. Race it with ``stkzoo race agents/pretrained/swift``, or with
``pretrained:swift`` if it is one of stkzoo's own agents.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import stkzoo
from stkzoo._arguments import option, positional
from stkzoo._os import PART_FILES, make_folder, write_text
from stkzoo._reading import reading
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.driver import CARD, WEIGHTS, read_card, read_numbers
from stkzoo.agents.pretrained.ensemble import (
    check_ensemble_weight,
    join_members,
    split_members,
)
from stkzoo.agents.pretrained.mlp import MlpDriver, is_network
from stkzoo.agents.pretrained.policy import check_shapes
from stkzoo.agents.pretrained.weights import (
    load_weights,
    packed_weights,
    save_weights,
)
from stkzoo.errors import ConfigError

from .common.command import run_command
from .common.run_folder import (
    ARGUMENTS,
    LEAGUE,
    kart_steps_of,
    plan_parameters,
    read_run_file,
    run_parameters,
    write_json,
)

#: Arrays with this in their name belong to the value network.
_VALUES = "value"

_MODULE = '''"""The learned driver {name}; see ``card.json``."""

from stkzoo.agents.pretrained.driver import functions_in

__all__ = ["create_state", "env_name", "get_actor", "get_batch_actor", "player_name"]

env_name = "supertuxkart/{view}-v0"
player_name = "{name}"
create_state, get_actor, get_batch_actor = functions_in(__file__)
'''

Arrays = dict[str, npt.NDArray[np.float32]]


def export_policy(
    weights: str | Path | Sequence[str | Path],
    name: str,
    folder: str | Path,
    ensemble_weight: float | None = None,
    plans: str | Path = "",
    *,
    recovers: bool = True,
    samples: bool = False,
) -> Path:
    """Writes the folder of an agent; replaces an existing agent, but no other folder.

    Args:
        weights: a policy of a run; with ``ensemble_weight``, one or more members of the ensemble:
            networks, policies over plans, and folders of ensembles, which add their members.
        name: name of the agent, a Python identifier.
        folder: folder of the agent.
        ensemble_weight: weight of the networks relative to the values of plans; ``None`` for no
            ensemble.
        plans: JSON file of plan parameters for an ensemble; empty for those with which its policies
            over plans learned, or the default ones.
        recovers: see :class:`~stkzoo.agents.pretrained.driver.AgentCard`, also for ``samples``.
        samples: whether a network without plans samples its choices.

    Returns:
        The folder.

    Raises:
        ConfigError: the weights are not a policy, the name is invalid, or the folder exists and is
            not an agent.
    """
    if not name.isidentifier():
        raise ConfigError(f"the name {name!r} is invalid; expected letters, digits and _")
    sources = [Path(weights)] if isinstance(weights, (str, Path)) else [Path(w) for w in weights]
    target = Path(folder)
    arrays, view, rules = _agent_of(sources, ensemble_weight, plans)
    make_folder(target, "agent")
    files = [path for path in target.iterdir() if not path.match(PART_FILES)]
    if files and not (target / CARD).exists():
        raise ConfigError(
            f"{str(target)!r} is not the folder of an agent; move its files away, or give another "
            "--output"
        )
    if files:
        read_card(target)  # a card that is not from this function is an error
    content = packed_weights(arrays)
    facts: dict[str, Any] = {
        "name": name,
        "sha256": hashlib.sha256(content).hexdigest(),
        "size": len(content),
        "parameters": sum(array.size for array in arrays.values()),
        "runs": [run for source in sources for run in _runs_of(source)],
        "stkzoo": stkzoo.__version__,
        "recovers": recovers,
        "samples": samples,
        **rules,
    }
    # The card is first: it marks the folder as an agent, even if this program is killed later.
    write_json(target / CARD, facts)
    save_weights(target / WEIGHTS, arrays)
    write_text(target / "__init__.py", f'"""The learned driver {name}; see ``card.json``."""\n')
    write_text(target / "pystk_actor.py", _MODULE.format(name=name, view=view))
    return target


def _agent_of(
    sources: Sequence[Path], ensemble_weight: float | None, plans: str | Path
) -> tuple[Arrays, str, dict[str, Any]]:
    """Returns an agent's arrays, its view, and the parameters of its plans."""
    if ensemble_weight is not None:
        check_ensemble_weight(ensemble_weight)
        joined, rules = _ensemble_of(sources, plans)
        facts = {"ensemble_weight": ensemble_weight, "rules": asdict(rules)}
        return joined, _view_of(rules), facts
    if plans:
        raise ConfigError(
            "only ensembles take other plans; add --ensemble-weight 1, or leave out --plans"
        )
    if len(sources) > 1:
        raise ConfigError(
            f"there are {len(sources)} files of weights, expected one; several networks can "
            "choose plans together, with --ensemble-weight 1"
        )
    arrays = load_weights(sources[0])
    if is_network(arrays):
        network = _network(arrays, sources[0])
        return network, MlpDriver(network).view, {}
    check_shapes(arrays, str(sources[0]))
    rules = run_parameters(sources[0])
    return arrays, _view_of(rules), {"rules": asdict(rules)}


def _view_of(rules: DriverParameters) -> str:
    """Returns the view that agents with these plans need."""
    return "ground" if rules.racing_line else "full"


def _ensemble_of(sources: Sequence[Path], plans: str | Path) -> tuple[Arrays, DriverParameters]:
    """Returns the arrays of an ensemble, and the parameters of its plans."""
    networks: list[Arrays] = []
    policies: list[Arrays] = []
    rules: list[DriverParameters] = []
    for source in sources:
        if source.is_dir():
            members = split_members(load_weights(source / WEIGHTS, read_card(source).sha256))
            if not any(members):
                raise ConfigError(f"{str(source)!r} is not an ensemble; name its {WEIGHTS}")
            networks += members[0]
            policies += members[1]
            if members[1]:
                rules.append(read_numbers(source))
            continue
        arrays = load_weights(source)
        if is_network(arrays):
            networks.append(_network(arrays, source))
        else:
            check_shapes(arrays, str(source))
            policies.append(arrays)
            rules.append(run_parameters(source))
    if plans or not rules:
        return join_members(networks, policies), plan_parameters(plans)
    if any(other != rules[0] for other in rules):
        raise ConfigError(
            "the policies over plans have runs with different plans; use policies of runs with "
            "the same --plans, or choose the plans with --plans"
        )
    return join_members(networks, policies), rules[0]


def _network(arrays: Arrays, source: Path) -> Arrays:
    """Returns the arrays of a file that a network needs for driving."""
    MlpDriver(arrays, repr(str(source)))
    return {name: array for name, array in arrays.items() if _VALUES not in name}


def _runs_of(source: Path) -> list[dict[str, Any]]:
    """Returns the training runs of a file of weights, or of an agent by its card."""
    if source.is_dir():
        return read_card(source).runs
    if (league := source.parent.parent / LEAGUE).exists():
        return [_run_of_member(league, source.stem)]
    arguments = source.with_name(ARGUMENTS)
    kart_steps = kart_steps_of(source)
    history: Any = read_run_file(Any, arguments) if arguments.exists() else []
    if isinstance(history, dict):  # a run with fixed arguments
        history = [{"from": 0, "arguments": history}]
    return [{"kart_steps": kart_steps, "history": history}]


def _run_of_member(league: Path, name: str) -> dict[str, Any]:
    """Returns the training run of a league's member, by the league's file."""
    with reading(f"{str(league)!r} cannot be read", "the file that the league wrote"):
        content = read_run_file(dict[str, Any], league)
        steps = {member["name"]: member["kart_steps"] for member in content["members"]}
        history = [{"from": 0, "arguments": content["arguments"]}]
    return {"kart_steps": steps.get(name), "history": history}


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of the command.

    Attributes:
        weights: policy-STEPS.safetensors of a run, or for an ensemble the folder of another one.
        name: name of the agent.
        output: folder of the agent.
        ensemble_weight: make an ensemble of networks and plans with this weight; 1 is usual.
        plans: JSON file of plan parameters for an ensemble (DriverParameters); empty takes those
            with which its policies over plans learned, or the default.
    """

    weights: tuple[Path, ...] = positional()
    name: str = option(required=True)
    output: Path = option(required=True, metavar="FOLDER")
    ensemble_weight: float | None = None
    plans: str = ""


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    return run_command("export", __doc__, _export, (ExportOptions,), words)


def _export(options: ExportOptions) -> None:
    weight = options.ensemble_weight
    folder = export_policy(options.weights, options.name, options.output, weight, options.plans)
    print(f"{folder} is an agent; try: stkzoo race {folder} ai ai ai ai --difficulty 3")


if __name__ == "__main__":
    sys.exit(main())
