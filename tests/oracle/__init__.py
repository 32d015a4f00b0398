"""NumPy implementations of the kernel's names: a module per C file.

``tests/kernel`` compares them with the extension, which is what runs.
"""

from tests.oracle.action_reader import ActionReader
from tests.oracle.car_controller import CarController
from tests.oracle.event_counter import EventCounter
from tests.oracle.kart_observer import KartObserver
from tests.oracle.messages import measure_message
from tests.oracle.mlp import Mlp
from tests.oracle.plan_memory import age_memory, write_memory
from tests.oracle.plan_viewer import present_plans, survey_road
from tests.oracle.plan_weigher import weigh_plans
from tests.oracle.racing_observer import RacingObserver
from tests.oracle.road_tracer import look_along, stack_vectors, trace_roads
from tests.oracle.rows import join_rows
from tests.oracle.step_scorer import StepScorer
from tests.oracle.track_graph import TrackGraph

__all__ = [
    "ActionReader",
    "CarController",
    "EventCounter",
    "KartObserver",
    "Mlp",
    "RacingObserver",
    "StepScorer",
    "TrackGraph",
    "age_memory",
    "join_rows",
    "look_along",
    "measure_message",
    "present_plans",
    "stack_vectors",
    "survey_road",
    "trace_roads",
    "weigh_plans",
    "write_memory",
]
