"""All checks by name, and how to run them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from stkzoo.checks import determinism, endings, manners, memory, spaces
from stkzoo.checks.factory import EnvFactory
from stkzoo.checks.failure import CheckFailed, NotApplicable

__all__ = ["CHECKS", "Check", "Outcome", "run_check"]

Check: TypeAlias = Callable[[EnvFactory], None]

#: Every check by its name without ``check_``, cheap ones first.
CHECKS: dict[str, Check] = {
    check.__name__.removeprefix("check_"): check
    for check in (
        spaces.check_spaces_are_constant,
        spaces.check_observations_are_in_their_spaces,
        spaces.check_state_is_in_its_space,
        endings.check_keys_are_the_acting_agents,
        endings.check_agents_leave_when_done,
        endings.check_types_of_rewards_and_ends,
        endings.check_finished_agents_leave_the_rest_racing,
        endings.check_step_after_the_end_is_empty,
        endings.check_actions_of_departed_agents_are_ignored,
        memory.check_infos_are_plain_numbers,
        memory.check_results_share_no_memory,
        memory.check_results_are_the_callers_own,
        manners.check_bad_actions_are_refused,
        manners.check_close_can_be_repeated_and_undone,
        manners.check_render_without_a_mode_warns,
        manners.check_nothing_is_written_to_the_terminal,
        determinism.check_seed_repeats_in_one_env,
        determinism.check_seed_repeats_in_two_envs,
        determinism.check_seed_repeats_in_a_fresh_process,
        determinism.check_seed_repeats_after_a_killed_worker,
        determinism.check_other_seed_differs,
        determinism.check_unseeded_resets_continue_the_stream,
        determinism.check_global_random_state_is_left_alone,
        determinism.check_envs_in_turn_do_not_meet,
        determinism.check_pickled_copies_play_the_same_race,
    )
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one check went.

    Attributes:
        status: ``"passed"``, ``"failed"`` or ``"not applicable"``.
        why: what is wrong, or why the check has nothing to look at; empty if passed.
        seconds: how long it took.
    """

    status: str
    why: str
    seconds: float


def run_check(check: Check, make_env: EnvFactory) -> Outcome:
    """Runs a check; whatever it raises becomes its outcome.

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
    return Outcome(status, why, time.perf_counter() - start)
