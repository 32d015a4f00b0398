"""stkzoo-suite-1: tasks, a population of opponents, and verified results for multi-agent racing.

>>> from stkzoo.suite import find_task
>>> env = find_task("versus").make()
>>> env.possible_agents
['kart_0']
>>> env.close()

Importing this package registers the tasks: ``gym.make("stkzoo-suite/versus-v1")``.
"""

from stkzoo.suite.about import CLASSES, About
from stkzoo.suite.conduct import Conduct, measure_conduct
from stkzoo.suite.entry import Entry, EntryPlan, evaluate, plan_entry
from stkzoo.suite.population import POPULATION, Member
from stkzoo.suite.report.document import SuiteReport
from stkzoo.suite.report.runs import Evaluation, LearningCurve, SuiteRun, load_runs
from stkzoo.suite.report.writing import make_report, write_suite_report
from stkzoo.suite.scores import Baselines, load_baselines, normalized
from stkzoo.suite.tasks import (
    ALGORITHMS,
    SUITE,
    TASKS,
    Task,
    can_learn,
    find_task,
    id_of,
    register_tasks,
    view_of,
)
from stkzoo.suite.verification import EntryRefused, proof_of, verify_entry

register_tasks()

__all__ = [
    "ALGORITHMS",
    "CLASSES",
    "POPULATION",
    "SUITE",
    "TASKS",
    "About",
    "Baselines",
    "Conduct",
    "Entry",
    "EntryPlan",
    "EntryRefused",
    "Evaluation",
    "LearningCurve",
    "Member",
    "SuiteReport",
    "SuiteRun",
    "Task",
    "can_learn",
    "evaluate",
    "find_task",
    "id_of",
    "load_baselines",
    "load_runs",
    "make_report",
    "measure_conduct",
    "normalized",
    "plan_entry",
    "proof_of",
    "verify_entry",
    "view_of",
    "write_suite_report",
]
__dir__ = __all__.copy
