"""NumPy implementations of the names of the C extensions: a module per C file.

``tests/kernel`` and ``tests/agents/planning`` compare them with the extensions, which races use.
Those of the planner (``plan_*``) are not imported here, because the planner is an agent.
"""

from tests.oracle.action_reader import ActionReader
from tests.oracle.car_controller import CarController
from tests.oracle.event_counter import EventCounter
from tests.oracle.kart_observer import KartObserver, action_mask
from tests.oracle.observations import to_polar
from tests.oracle.racing_observer import (
    look_around,
    observe_racing,
    observe_standing,
    write_racing_view,
)
from tests.oracle.road_tracer import trace_roads
from tests.oracle.rows import join_rows, new_batch, split_batch
from tests.oracle.step_scorer import StepScorer
from tests.oracle.track_graph import TrackGraph

__all__ = [
    "ActionReader",
    "CarController",
    "EventCounter",
    "KartObserver",
    "StepScorer",
    "TrackGraph",
    "action_mask",
    "join_rows",
    "look_around",
    "new_batch",
    "observe_racing",
    "observe_standing",
    "split_batch",
    "to_polar",
    "trace_roads",
    "write_racing_view",
]
