"""Export of demonstrations to Minari."""

from __future__ import annotations

import json
import warnings
from typing import Any

import numpy as np

from stkzoo._imports import import_extra
from stkzoo.errors import ConfigError
from stkzoo.evaluation.demonstrations.dataset import DemoEpisode, Demonstrations
from stkzoo.evaluation.demonstrations.recorder import DemoView


def require_minari() -> Any:
    """Imports ``minari``.

    Raises:
        ConfigError: Minari is not installed.
    """
    return import_extra("minari", "this format needs", "demos", "or write --format safetensors")


def check_dataset_id(dataset_id: str) -> None:
    """Checks that Minari can create a dataset with an id.

    Raises:
        ConfigError: Minari is not installed, or the id is malformed or in use.
    """
    minari = require_minari()
    try:
        minari.dataset.minari_dataset.parse_dataset_id(dataset_id)
    except (ValueError, TypeError) as error:
        why = "it has no version" if isinstance(error, TypeError) else error
        raise _rejected(dataset_id, why) from error
    if dataset_id in minari.list_local_datasets():
        raise _rejected(dataset_id, "it exists already")


def _rejected(dataset_id: str, why: object) -> ConfigError:
    return ConfigError(
        f"Minari rejects the dataset {dataset_id!r}: {why}; expected a name such as "
        "supertuxkart/heuristic-v0 that is not in use"
    )


def to_minari(demos: Demonstrations, dataset_id: str) -> Any:
    """Adds demonstrations to Minari's local datasets.

    Args:
        demos: the dataset.
        dataset_id: id of the new dataset, such as ``"supertuxkart/heuristic-v0"``. The
            environment variable ``MINARI_DATASETS_PATH`` sets the folder of Minari's datasets.

    Returns:
        The ``minari.MinariDataset``. The metadata of each episode includes its facts, such as
        ``track`` and ``finish_time``.

    Raises:
        ConfigError: Minari is not installed, or rejects the id, for example because it is in use.
    """
    check_dataset_id(dataset_id)
    minari = require_minari()
    view = DemoView(demos.view)
    buffers = [_buffer(minari, number, demos[number]) for number in range(len(demos))]
    agent = demos.plan["agents"][0]["label"]
    about = {
        "algorithm_name": agent,
        "description": (
            f"Observations and actions of {agent} in SuperTuxKart, in stkzoo's view {demos.view}, "
            f"on {', '.join(demos.plan['tracks'])}."
        ),
    }
    spaces = {"observation_space": view.observation_space, "action_space": view.action_space}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # Minari warns without an environment id
            dataset = minari.create_dataset_from_buffers(dataset_id, buffers, **spaces, **about)
    except (ValueError, AttributeError, AssertionError) as error:
        raise _rejected(dataset_id, error) from error
    dataset.storage.update_metadata({"stkzoo": json.dumps(dict(demos.plan))})
    dataset.storage.update_episode_metadata(
        [
            {name: value for name, value in episode.items() if value is not None}
            for episode in demos.to_dict()["episodes"]
        ]
    )
    return dataset


def _buffer(minari: Any, number: int, episode: DemoEpisode) -> Any:
    steps = len(episode)
    last = np.arange(steps) == steps - 1
    return minari.data_collector.EpisodeBuffer(
        id=number,
        seed=episode.facts.seed,
        observations=episode.observations,
        actions=episode.actions,
        rewards=list(episode.rewards),
        terminations=list(last & episode.is_finished),
        truncations=list(last & (not episode.is_finished)),
    )
