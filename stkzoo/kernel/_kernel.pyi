"""The names of the C extension. A comment in C has the formula of each."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

#: Sizes of the records of a snapshot, to compare with the dtypes: header, kart and item [bytes].
RECORD_SIZES: tuple[int, int, int]

class GameStepper:
    """Steps a race of the engine, and reads its state.

    Args:
        functions: ``step`` and ``get_kart_action`` of a ``pystk2.Race`` that has started, and
            ``update`` and ``__getstate__`` of its world.
        world: its ``pystk2.WorldState``.
        actions: a ``pystk2.Action`` for each player kart, in grid order.
        controls: names of the controls, which are attributes of an action.
        phases: number of each of the engine's phases.
        last_phase: number of all other phases.
        reporting: karts of the game's AI whose controls are read.
        players: ``(P,)`` kart of each action.
    """

    def __new__(
        cls,
        functions: tuple[Callable[..., Any], ...],
        world: Any,
        actions: list[Any],
        controls: tuple[str, ...],
        phases: dict[Any, int],
        last_phase: int,
        reporting: tuple[int, ...],
        players: npt.NDArray[np.intp],
    ) -> GameStepper: ...
    def step(self, controls: bytes | npt.NDArray[np.float32]) -> bytes:
        """Advances the game by one step.

        Args:
            controls: ``(P, 7)`` float32, or its bytes: a row for each player kart.

        Returns:
            The bytes of a :class:`~stkzoo.engine.snapshot.Snapshot` after the step.
        """
    def read(self) -> bytes:
        """Returns the bytes of a snapshot of the current state of a race that is running."""
    def serve(self, fd: int) -> bytes:
        """Serves step requests on a packet socket until another request arrives; returns that one.

        Raises:
            EOFError: the other end has closed the connection.
        """

class TrackGraph:
    """A track's segments, and the order of the segments ahead of each one.

    Args:
        nodes: start and end of each segment [m].
        widths: width of each segment [m].
        distances: distances along the lap from the start line to each segment's start and end [m].
        begins: ``(N + 1,)``: the successors of segment ``n`` are
            ``successors[begins[n] : begins[n + 1]]``.
        successors: numbers of the successors of all segments.
        length: length of a lap [m].

    Raises:
        ValueError: the arrays do not fit together.
    """

    def __new__(
        cls,
        nodes: npt.NDArray[np.float32],
        widths: npt.NDArray[np.float32],
        distances: npt.NDArray[np.float32],
        begins: npt.NDArray[np.intp],
        successors: npt.NDArray[np.intp],
        length: float,
    ) -> TrackGraph: ...
    def ahead(self, node: int) -> npt.NDArray[np.intp]:
        """Returns all segments in order of driving distance from a segment, ``(N,)``."""

class KartObserver:
    """Makes the observations of one view.

    Args:
        entries: name of each entry of the observation, in order; name of the array that has it in a
            batch, alone or with others as a vector; and length of its one-hot encoding, or 0.
        items: number of items in the observation; -1 for all items of the race.
        karts: number of other karts in the observation; -1 for all.
        paths: number of track segments in the observation; -1 for all visible ones.
        polar: whether positions are two angles and a distance.
        uses: ``(2, n)``, which actions press nitro, and which fire, for the entry ``action_mask``.

    Raises:
        ValueError: the arguments do not fit together.
    """

    def __new__(
        cls,
        entries: tuple[tuple[str, str, int], ...],
        items: int = -1,
        karts: int = -1,
        paths: int = -1,
        polar: bool = False,
        uses: npt.NDArray[np.bool_] | None = None,
    ) -> KartObserver: ...
    def observe(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: npt.NDArray[np.intp],
    ) -> list[Any]:
        """Returns a list with one observation per kart, in which lists are tuples.

        Args:
            track: the race's track.
            num_paths: number of visible segments of the track.
            kart_types: model name of each kart.
            data: bytes of the snapshot.
            who: ``(A,)`` indices of the observing karts.

        Raises:
            ValueError: the arguments do not fit together.
        """
    def observe_into(
        self,
        track: TrackGraph,
        num_paths: int,
        kart_types: tuple[str, ...],
        data: bytes,
        who: npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        batch: Any,
    ) -> None:
        """Writes the observations into rows of a batch.

        Args:
            track: see :meth:`observe`.
            num_paths: see :meth:`observe`.
            kart_types: see :meth:`observe`.
            data: see :meth:`observe`.
            who: see :meth:`observe`.
            rows: row of each kart.
            batch: arrays by entry, with a list for names, or one array if the view is one vector.

        Raises:
            ValueError: the arguments do not fit together.
        """

class ActionReader:
    """Converts actions of one space to controls.

    Args:
        names: keys of an action; empty if an action is one array or number.
        leaves: for each key, a tuple per number: its lowest value, its highest value, whether it is
            a whole number, its column in the controls, and a table or ``None``. A table belongs to
            a choice and has a row for each value; that row is added to the controls from the column
            on.

    Raises:
        ValueError: the leaves do not fit together.
    """

    def __new__(cls, names: tuple[str, ...], leaves: tuple[Any, ...]) -> ActionReader: ...
    def read(
        self,
        actions: Any,
        who: tuple[str, ...] | npt.NDArray[np.intp],
        rows: npt.NDArray[np.intp],
        controls: npt.NDArray[np.float32],
        count: int = -1,
    ) -> bool:
        """Reads one action for each of ``rows`` into that row of the controls.

        Args:
            actions: actions by agent; with ``count``, an array with a row for each slot, or a dict
                of such arrays.
            who: the agents; with ``count``, their slots.
            rows: row of each action in ``controls``.
            controls: ``(P, 7)`` float32, whose rows are overwritten.
            count: number of slots.

        Returns:
            Whether all actions are in their space and in a usual form.
        """

class CarController:
    """Converts a speed or acceleration and a steering angle or steering speed to controls.

    Args:
        kinds: whether the longitudinal number is a speed, whether the steering number is an angle,
            and whether both are scaled to [-1, 1].
        limits: limits of the steering number, of the longitudinal number, and of the kart.
        pedals: model of the kart.
    """

    def __new__(
        cls,
        kinds: tuple[bool, bool, bool],
        limits: tuple[float, ...],
        pedals: npt.NDArray[np.float64],
    ) -> CarController: ...
    def drive(
        self,
        controls: npt.NDArray[np.float32],
        rows: npt.NDArray[np.intp],
        data: bytes,
        karts: npt.NDArray[np.intp],
        states: npt.NDArray[np.float64],
        places: npt.NDArray[np.intp],
    ) -> None:
        """Replaces actions by the controls that the game takes.

        Args:
            controls: ``(P, 7)``; the columns of steering and throttle hold the action's steering
                and longitudinal numbers.
            rows: ``(A,)`` rows to change.
            data: bytes of the current snapshot.
            karts: ``(A,)`` kart of each row.
            states: ``(S, 3)`` two columns of the controllers' memory, which are updated, and the
                length of a step [s].
            places: ``(A,)`` row of each kart in ``states``.
        """

class EventCounter:
    """Counts the events of all K karts of a race, step by step.

    Args:
        nodes: ``(N, 2, 3)`` float32, start and end of the track's segments [m].
        step_size: game time of a step [s].
        memory: ``(K, 8 + K)`` memory of the events, which :meth:`count` updates. Columns 0 to 2 are
            the times for which each kart has been off the road, has driven the wrong way and has
            stayed within 3 m [s]. Columns 3 to 5 are the place that it has stayed near. Initialize
            columns 3 to 5 with infinity and the others with zeros.
        counts: ``(K, 10)`` events of the step (:data:`stkzoo.mdp.events.EVENTS`), which
            :meth:`count` writes.

    Raises:
        ValueError: the arrays do not fit together.
    """

    def __new__(
        cls,
        nodes: npt.NDArray[np.float32],
        step_size: float,
        memory: npt.NDArray[np.float64],
        counts: npt.NDArray[np.float64],
    ) -> EventCounter: ...
    def count(self, before: bytes, after: bytes) -> None:
        """Counts the events of the step between two snapshots.

        Args:
            before: bytes of the snapshot before the step.
            after: bytes of the snapshot after the step.

        Raises:
            ValueError: a snapshot has another number of karts.
        """

class StepScorer:
    """Computes rewards, ends and infos of the agents of a race.

    Args:
        karts: ``(A,)`` kart of each agent.
        last: ``(A, C)`` reward terms and events of the latest step, which :meth:`score_into`
            writes.
        sums: ``(A, C)`` sums of ``last`` over the episode, which :meth:`score_into` updates.
        owed: ``(A, T)`` what each agent has earned by each of the T reward terms but not been paid,
            which :meth:`score_into` updates.
        limits: ``(A, T)`` most that a term pays in a step, and a tenth of it for what is owed;
            infinite without a limit. The first T columns of ``last`` are terms, the others events.
        race_length: number of laps times the length of a lap [m].
        rewards: for each agent the names of its reward's terms, their weights, and their columns in
            ``last``. The caller writes the terms that are Python functions into ``last``.
        events: ``(K, E)`` events of the step of all karts, which are copied into the last columns
            of ``last``; any empty array without events.
    """

    def __new__(
        cls,
        karts: npt.NDArray[np.intp],
        last: npt.NDArray[np.float64],
        sums: npt.NDArray[np.float64],
        owed: npt.NDArray[np.float64],
        limits: npt.NDArray[np.float64],
        race_length: float,
        rewards: tuple[Any, ...],
        events: npt.NDArray[np.float64],
    ) -> StepScorer: ...
    def score_into(
        self,
        before: bytes,
        after: bytes,
        is_over: bool,
        who: npt.NDArray[np.intp],
        slots: npt.NDArray[np.intp],
        rewards: npt.NDArray[np.float64],
        terminations: npt.NDArray[np.bool_],
        truncations: npt.NDArray[np.bool_],
    ) -> None:
        """Computes the step between two snapshots and writes its results, a number for each slot.

        Args:
            before: bytes of the snapshot before the step.
            after: bytes of the snapshot after the step.
            is_over: whether the time limit is reached.
            who: numbers of the agents that acted.
            slots: slot of each of them.
            rewards: ``(S,)`` float64, which is written.
            terminations: ``(S,)`` bool, which is written.
            truncations: ``(S,)`` bool, which is written.
        """
    def infos_into(
        self,
        data: bytes,
        length: int,
        who: npt.NDArray[np.intp],
        slots: npt.NDArray[np.intp],
        wholes: npt.NDArray[np.int64],
        numbers: npt.NDArray[np.float64],
    ) -> None:
        """Writes the infos of some agents at a snapshot into two tables with a column per slot.

        Args:
            data: bytes of the snapshot.
            length: number of steps of the episode.
            who: numbers of the agents.
            slots: slot of each of them.
            wholes: ``(3, S)`` rank, laps and ``length``, which are written.
            numbers: ``(3 + 2 C, S)`` distance [m], finish time [s], the agent's row of ``last``,
                its row of ``sums``, and the sum of its reward terms, which are written.
        """

def action_mask(energy: float, powerup: int, uses: npt.NDArray[np.bool_]) -> npt.NDArray[np.int8]:
    """Returns 1 for actions that have an effect, otherwise 0, ``(n,)`` int8.

    Args:
        energy: nitro in the kart's tank.
        powerup: number of its powerup; 0 for none.
        uses: ``(2, n)``, which actions press nitro, and which fire.
    """

def to_polar(points: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Converts positions ``(..., 3)`` [m] to two angles [rad] and a distance [m]."""

def join_rows(rows: tuple[Any, ...]) -> bytes | None:
    """Returns the concatenated bytes of arrays of one dtype and shape.

    Returns:
        The bytes; ``None`` if the arrays differ in dtype or shape, or are not contiguous.
    """

def trace_roads(
    starts: npt.NDArray[np.float32],
    ends: npt.NDArray[np.float32],
    widths: npt.NDArray[np.float32],
    counts: npt.NDArray[np.intp],
    rules: npt.NDArray[np.float64],
    lines: npt.NDArray[np.float32],
    looks: npt.NDArray[np.float32],
    points: npt.NDArray[np.float32],
) -> None:
    """Writes the lines ahead of ``A`` karts, and the lines' points at some distances.

    Args:
        starts: ``(A, P, 3)`` starts of the segments ahead of each kart, ordered by driving
            distance; the kart's own segment comes first. P is at most 128.
        ends: ``(A, P, 3)`` their ends.
        widths: ``(A, P)`` their widths.
        counts: ``(A,)`` number of segments of each kart. If there are none, one segment of zero
            length at the kart is used.
        rules: ``(4,)`` distance between the line's points, distance below which segments touch,
            longest jump between segments that do not touch, and length of the straight extension
            beyond the last segment [m].
        lines: ``(A, N, 4)`` points and their distances to the edge of the road [m], which are
            written.
        looks: ``(L,)`` distances ahead of the karts, which are at the origin [m].
        points: ``(A, L, 4)`` points of the lines at these distances, which are written.

    Raises:
        ValueError: the arrays do not fit together.
    """

def new_batch(like: Any, count: int) -> Any:
    """Returns a batch of ``count`` rows without content in the form of another batch.

    A batch holds one value for each of several agents: an array with a row for each, a list of
    texts, or a dict of batches.

    Args:
        like: a batch with any number of rows.
        count: number of rows.
    """

def split_batch(batch: Any, agents: tuple[Any, ...]) -> dict[Any, Any]:
    """Returns the values of a batch's first rows by agent.

    Rows of arrays are views; the entries of arrays with one axis are Python numbers.
    """

def look_around(
    road: tuple[Any, ...],
    data: bytes,
    who: npt.NDArray[np.intp],
    looks: npt.NDArray[np.float32],
    around: tuple[npt.NDArray[Any], ...],
) -> None:
    """Writes the surroundings of some karts on a road.

    Args:
        road: ``road`` of a :class:`~stkzoo.wrappers.racing.surroundings.RoadObserver`.
        data: bytes of a snapshot.
        who: ``(n,)`` indices of karts.
        looks: ``(L,)`` distances at which the road is observed [m].
        around: the first five arrays of :class:`~stkzoo.wrappers.racing.Surroundings`, which are
            written. Karts and items for which there is no room are left out.

    Raises:
        IndexError: a kart is on a segment that the road does not have.
        ValueError: the arrays do not fit together.
    """

def write_racing_view(
    tables: tuple[Any, ...],
    around: tuple[npt.NDArray[Any], ...],
    out: npt.NDArray[np.float32],
) -> None:
    """Writes the view ``racing`` of karts with given surroundings.

    Args:
        tables: :data:`stkzoo.wrappers.racing.features.KERNEL_TABLES`.
        around: the first five arrays of :class:`~stkzoo.wrappers.racing.Surroundings`.
        out: ``(n, F)``; the first ``SIZE`` columns are written.

    Raises:
        ValueError: the arrays do not fit together.
    """

def observe_standing(
    data: bytes,
    teams: npt.NDArray[np.intp],
    race_length: float,
    who: npt.NDArray[np.intp],
    rows: npt.NDArray[np.intp],
    out: npt.NDArray[np.float32],
    column: int,
) -> None:
    """Writes the standing of each kart of ``who`` (:data:`stkzoo.mdp.spaces.STANDING`).

    Args:
        data: bytes of a snapshot.
        teams: ``(K,)`` team of each kart; -1 for none.
        race_length: length of the race [m].
        who: ``(n,)`` indices of karts.
        rows: ``(n,)`` row of each kart.
        out: ``(N, F)``; ``STANDING_SIZE`` of its columns are written.
        column: the first of them.

    Raises:
        IndexError: a kart or its row does not exist.
        ValueError: the arrays do not fit together.
    """

def observe_racing(
    road: tuple[Any, ...],
    tables: tuple[Any, ...],
    data: bytes,
    who: npt.NDArray[np.intp],
    rows: npt.NDArray[np.intp],
    out: npt.NDArray[np.float32],
) -> None:
    """Writes the view ``racing`` of each kart of ``who`` into a row of ``out``.

    Args:
        road: see :func:`look_around`.
        tables: see :func:`write_racing_view`.
        data: bytes of a snapshot.
        who: ``(n,)`` indices of karts.
        rows: ``(n,)`` row of each kart.
        out: ``(N, F)``; the first ``SIZE`` columns are written.

    Raises:
        IndexError: a kart, its segment or its row does not exist.
        ValueError: the arrays do not fit together.
    """
