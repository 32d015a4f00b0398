"""Processes that drive races for a learner, and the memory that they share with it."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.errors import StkzooError

from .command import limit_threads

_END_TIMEOUT = 5.0  # [s]
#: New interpreters: a fork would share the learner's threads and open files.
_context = multiprocessing.get_context("spawn")


class SharedArray:
    """An array in anonymous memory that a process shares with the processes that it starts.

    Args:
        shape: shape of the array.
        dtype: type of its elements.
    """

    def __init__(self, shape: tuple[int, ...], dtype: npt.DTypeLike) -> None:
        self._shape, self._dtype = shape, np.dtype(dtype)
        self._memory = _context.RawArray("b", max(self._dtype.itemsize * int(np.prod(shape)), 1))

    def array(self) -> npt.NDArray[Any]:
        """Returns the array; changes are visible to all processes."""
        flat = np.frombuffer(self._memory, self._dtype, int(np.prod(self._shape)))
        return flat.reshape(self._shape)


class ActorPool:
    """Processes with one actor each, an object whose methods the learner calls.

    Args:
        make: makes an actor in its process.
        arguments: arguments of ``make`` for each process; values that can be pickled, and
            :class:`SharedArray`.

    Attributes:
        is_busy: whether the actors work on a call of :meth:`send`.
    """

    def __init__(self, make: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> None:
        self._processes, self._connections = [], []
        self.is_busy = False
        for actor_arguments in arguments:
            connection, actor_end = _context.Pipe()
            process = _context.Process(
                target=_serve, args=(actor_end, make, actor_arguments), daemon=True
            )
            process.start()
            actor_end.close()
            self._processes.append(process)
            self._connections.append(connection)

    def __len__(self) -> int:
        return len(self._processes)

    @property
    def pids(self) -> list[int]:
        """Ids of the processes."""
        return [process.pid for process in self._processes if process.pid is not None]

    def call(self, method: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Calls a method of all actors.

        Args:
            method: name of the method.
            arguments: its arguments for each actor.

        Returns:
            The result of each actor.

        Raises:
            StkzooError: an actor failed.
        """
        self.send(method, arguments)
        return self.receive()

    def send(self, method: str, arguments: Sequence[tuple[Any, ...]]) -> None:
        """Starts a :meth:`call`; :meth:`receive` returns its results."""
        for connection, actor_arguments in zip(self._connections, arguments, strict=True):
            with contextlib.suppress(OSError):  # receive reports the error
                connection.send((method, actor_arguments))
        self.is_busy = True

    def receive(self) -> list[Any]:
        """Waits for the results of :meth:`send`.

        Raises:
            StkzooError: an actor failed.
        """
        self.is_busy = False
        return [self._result(number) for number in range(len(self))]

    def close(self) -> None:
        """Ends the processes."""
        for connection in self._connections:
            connection.close()  # ends an actor that waits for a call
        for process in self._processes:
            if self.is_busy:
                process.terminate()
            process.join(_END_TIMEOUT)
            if process.is_alive():
                process.kill()
                process.join()

    def _result(self, number: int) -> Any:
        try:
            is_done, result = self._connections[number].recv()
        except (EOFError, OSError):
            process = self._processes[number]
            process.join(_END_TIMEOUT)
            raise StkzooError(
                f"a process that drives races ended with code {process.exitcode}; the same "
                "command continues"
            ) from None
        if not is_done:
            raise result
        return result


def _serve(connection: Connection, make: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Runs an actor until the learner closes the connection or ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # this process ends with the learner
    end_with_parent()
    limit_threads()
    is_made, actor = _outcome(make, arguments)
    with contextlib.suppress(EOFError, OSError):
        while True:
            method, call_arguments = connection.recv()
            answer = _outcome(getattr(actor, method), call_arguments) if is_made else (False, actor)
            connection.send(answer)
    if is_made:
        actor.close()


def _outcome(call: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any]:
    """Returns whether a call succeeds, and its result or error."""
    try:
        return True, call(*arguments)
    except StkzooError as error:
        return False, error
    except Exception:  # noqa: BLE001 - the learner raises it
        trace = traceback.format_exc()
        return False, StkzooError(f"a process that drives races failed:\n{trace}")


def end_with_parent() -> None:
    """Ends this process when its parent process has ended."""
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
