"""All checks by name, and how to run them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from stkzoo.checks import api_usage, determinism, endings, memory, spaces
from stkzoo.checks.play import CheckFailed, EnvFactory, NotApplicable

Check: TypeAlias = Callable[[EnvFactory], None]

#: Every check by its name without ``check_``.
CHECKS: dict[str, Check] = {
    name.removeprefix("check_"): check
    for module in (spaces, endings, memory, api_usage, determinism)
    for name, check in vars(module).items()
    if name in module.__all__
}


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of one check.

    Attributes:
        status: ``"passed"``, ``"failed"`` or ``"not applicable"``.
        why: what is wrong, or why the check does not apply; empty if passed.
        seconds: duration [s].
    """

    status: str
    why: str
    seconds: float


def run_check(check: Check, make_env: EnvFactory) -> CheckResult:
    """Runs a check; an exception becomes a failure.

    Args:
        check: one of :data:`CHECKS`.
        make_env: makes the environment.
    """
    start = time.perf_counter()
    status, why = "failed", ""
    try:
        check(make_env)
        status = "passed"
    except NotApplicable as reason:
        status, why = "not applicable", str(reason)
    except CheckFailed as failure:
        why = str(failure)
    except Exception as error:  # noqa: BLE001 - a broken environment may raise anything
        why = f"{type(error).__name__}: {error}"
    return CheckResult(status, why, time.perf_counter() - start)
