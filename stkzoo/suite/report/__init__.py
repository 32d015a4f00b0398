"""Reports of training runs in the suite: result files, statistics, tables and figures."""

from stkzoo.suite.report.document import SuiteReport
from stkzoo.suite.report.results import LearningCurve, RaceScore, SplitScores, SuiteRun, load_runs
from stkzoo.suite.report.writing import make_report, write_suite_report

__all__ = [
    "LearningCurve",
    "RaceScore",
    "SplitScores",
    "SuiteReport",
    "SuiteRun",
    "load_runs",
    "make_report",
    "write_suite_report",
]
