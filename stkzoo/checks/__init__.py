"""Conformance checks for PettingZoo environments, stricter than PettingZoo's own.

Each check is a function of a factory (anything that returns a fresh ``ParallelEnv``) and
raises :class:`CheckFailed` with a text that says which agent, step and key broke the rule.

>>> from stkzoo import race_v0
>>> from stkzoo.checks import check_spaces_are_constant
>>> check_spaces_are_constant(race_v0.parallel_env)

Run them all with ``python -m stkzoo.checks stkzoo.race_v0:parallel_env``, or on your own
environment or wrapper with ``python -m stkzoo.checks my_module:make_env``. A factory that
names ``agents``, ``num_kart``, ``track`` or ``max_cycles`` in its signature, as
:func:`stkzoo.race_v0.parallel_env` does, is given values that make short whole races in
which agents finish at different times; keywords that ``functools.partial`` has bound are
left alone.
"""

from stkzoo.checks.determinism import (
    check_envs_in_turn_do_not_meet,
    check_global_random_state_is_left_alone,
    check_other_seed_differs,
    check_pickled_copies_play_the_same_race,
    check_seed_repeats_after_a_killed_worker,
    check_seed_repeats_in_a_fresh_process,
    check_seed_repeats_in_one_env,
    check_seed_repeats_in_two_envs,
    check_unseeded_resets_continue_the_stream,
)
from stkzoo.checks.endings import (
    check_actions_of_departed_agents_are_ignored,
    check_agents_leave_when_done,
    check_finished_agents_leave_the_rest_racing,
    check_keys_are_the_acting_agents,
    check_step_after_the_end_is_empty,
    check_types_of_rewards_and_ends,
)
from stkzoo.checks.factory import EnvFactory, load_factory
from stkzoo.checks.failure import CheckFailed, NotApplicable
from stkzoo.checks.manners import (
    check_bad_actions_are_refused,
    check_close_can_be_repeated_and_undone,
    check_nothing_is_written_to_the_terminal,
    check_render_without_a_mode_warns,
)
from stkzoo.checks.memory import (
    check_infos_are_plain_numbers,
    check_results_are_the_callers_own,
    check_results_share_no_memory,
)
from stkzoo.checks.play import RandomPolicy, Step, play
from stkzoo.checks.runner import CHECKS, Check, Outcome, run_check
from stkzoo.checks.spaces import (
    check_observations_are_in_their_spaces,
    check_spaces_are_constant,
    check_state_is_in_its_space,
)
from stkzoo.checks.trace import Trace, first_difference, trace

__all__ = [
    "CHECKS",
    "Check",
    "CheckFailed",
    "EnvFactory",
    "NotApplicable",
    "Outcome",
    "RandomPolicy",
    "Step",
    "Trace",
    "check_actions_of_departed_agents_are_ignored",
    "check_agents_leave_when_done",
    "check_bad_actions_are_refused",
    "check_close_can_be_repeated_and_undone",
    "check_envs_in_turn_do_not_meet",
    "check_finished_agents_leave_the_rest_racing",
    "check_global_random_state_is_left_alone",
    "check_infos_are_plain_numbers",
    "check_keys_are_the_acting_agents",
    "check_nothing_is_written_to_the_terminal",
    "check_observations_are_in_their_spaces",
    "check_other_seed_differs",
    "check_pickled_copies_play_the_same_race",
    "check_render_without_a_mode_warns",
    "check_results_are_the_callers_own",
    "check_results_share_no_memory",
    "check_seed_repeats_after_a_killed_worker",
    "check_seed_repeats_in_a_fresh_process",
    "check_seed_repeats_in_one_env",
    "check_seed_repeats_in_two_envs",
    "check_spaces_are_constant",
    "check_state_is_in_its_space",
    "check_step_after_the_end_is_empty",
    "check_types_of_rewards_and_ends",
    "check_unseeded_resets_continue_the_stream",
    "first_difference",
    "load_factory",
    "play",
    "run_check",
    "trace",
]
