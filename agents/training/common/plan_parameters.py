"""The parameters of the plans of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from stkzoo.agents.planning import DriverParameters
from stkzoo.errors import ConfigError

from .run_folder import ARGUMENTS


def plan_parameters(file: str | Path) -> DriverParameters:
    """The parameters in a JSON file, such as ``best.json`` of ``tune_plans``.

    Args:
        file: the file; empty is the default parameters.

    Raises:
        ConfigError: the file is unreadable, or has other parameters.
    """
    if not file:
        return DriverParameters()
    return _parameters(file, lambda content: content)


def run_parameters(folder: Path) -> DriverParameters:
    """The parameters of a run's plans; the default ones if the folder has no run.

    Raises:
        ConfigError: the run is of another version.
    """
    file = folder / ARGUMENTS
    return (
        _parameters(file, lambda content: content[-1]["rules"])
        if file.exists()
        else plan_parameters("")
    )


def _parameters(file: str | Path, find: Any) -> DriverParameters:
    try:
        return DriverParameters(**find(json.loads(Path(file).read_text())))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(
            f"{str(file)!r} has no parameters of plans as this version of stkzoo has them "
            f"({error}); give another file, or the version that wrote it"
        ) from None
