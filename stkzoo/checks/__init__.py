"""Conformance checks for PettingZoo environments, stricter than PettingZoo's own.

Each check takes a factory, a callable that returns a new ``ParallelEnv``. It raises
:class:`CheckFailed` with a message that names the agent, step and key that broke the rule.

>>> from stkzoo import race_v0
>>> from stkzoo.checks import check_spaces_are_constant
>>> check_spaces_are_constant(race_v0.parallel_env)

Run all checks with ``python -m stkzoo.checks stkzoo.race_v0:parallel_env``, or on your own
environment or wrapper with ``python -m stkzoo.checks my_module:make_env``. If the factory's
signature names ``agents``, ``num_kart``, ``track`` or ``max_cycles``, as that of
:func:`stkzoo.race_v0.parallel_env` does, the checks pass values that make short whole races in
which agents finish at different times. Arguments bound by ``functools.partial`` are kept.
"""

from stkzoo.checks import conduct, determinism, values
from stkzoo.checks.conduct import *  # noqa: F403 - all public functions named check_
from stkzoo.checks.determinism import *  # noqa: F403
from stkzoo.checks.play import (
    Check,
    CheckFailed,
    CheckResult,
    EnvFactory,
    NotApplicable,
    RandomPolicy,
    Step,
    Trace,
    first_difference,
    load_factory,
    play,
    run_check,
    trace,
)
from stkzoo.checks.values import *  # noqa: F403

#: All checks by name, without the prefix ``check_``.
CHECKS: dict[str, Check] = {
    name.removeprefix("check_"): check
    for module in (values, conduct, determinism)
    for name, check in vars(module).items()
    if name.startswith("check_")
}

__all__ = [
    "CHECKS",
    "Check",
    "CheckFailed",
    "CheckResult",
    "EnvFactory",
    "NotApplicable",
    "RandomPolicy",
    "Step",
    "Trace",
    "first_difference",
    "load_factory",
    "play",
    "run_check",
    "trace",
    *(f"check_{name}" for name in CHECKS),
]
