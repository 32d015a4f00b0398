"""The common form of all sections."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import stkzoo.views
from benchmarks.common import Result, Table

#: Views that pystk2-gymnasium also has.
REFERENCE_VIEWS = ("full", "simple", "flattened", "flattened_discrete")
#: All views without camera images, those of the reference first.
VIEWS = tuple(sorted(stkzoo.views.VIEWS, key=lambda view: view not in REFERENCE_VIEWS))

Job = Mapping[str, Any]


@dataclass(frozen=True)
class Section:
    """A part of the program that answers one question.

    Attributes:
        help: what it measures.
        jobs: returns what to measure with some options; each job becomes one result.
        measure: measures a job.
        tables: returns the tables of the results.
        defaults: values of options that are not given.
        quick: the same for ``--quick``.
    """

    help: str
    jobs: Callable[[argparse.Namespace], Sequence[Job]]
    measure: Callable[[Job, argparse.Namespace], Mapping[str, Any]]
    tables: Callable[[Sequence[Result]], Sequence[Table]]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    quick: Mapping[str, Any] = field(default_factory=dict)
