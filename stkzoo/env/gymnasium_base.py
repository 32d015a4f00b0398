"""What the Gymnasium environments share: the core inside, and the reference's names for it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import EzPickle

from stkzoo.config import AgentSpec
from stkzoo.engine.assets import find_assets
from stkzoo.engine.fork_client import can_fork, start_fork_server
from stkzoo.engine.track import TrackMap
from stkzoo.env.graphics import RENDER_MODES
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.state import RaceState
from stkzoo.env.world import WorldView
from stkzoo.errors import ApiOrderError

_Self = TypeVar("_Self", bound="GymnasiumRaceEnv")


class _TrackNames:
    """The names of all race tracks, read when they are first asked for."""

    def __get__(self, instance: object, owner: type | None = None) -> list[str]:
        return list(find_assets().tracks)


class GymnasiumRaceEnv(gym.Env[Any, Any], EzPickle):
    """A Gymnasium environment over the parallel core.

    Attributes:
        core: the :class:`~stkzoo.env.parallel.RaceParallelEnv` that it is a view of.
        TRACKS: names of all race tracks.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's convention
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
    }
    TRACKS = _TrackNames()

    def __init__(self, agents: Sequence[AgentSpec] | int | None, **options: Any) -> None:
        # Gymnasium's TimeLimit, which the registered ids bring, cuts long races.
        options.setdefault("max_cycles", None)
        self.core = RaceParallelEnv(agents=agents, **options)
        self.render_mode = self.core.render_mode
        self.metadata = {**self.metadata, "render_fps": self.core.metadata["render_fps"]}

    @classmethod
    def initialize(
        cls,
        with_graphics: bool = False,
        use_subprocess: bool = True,
        graphics_config: Any = None,  # noqa: ARG003 - the reference's argument
    ) -> list[str]:
        """Starts the game's process ahead of the first race and returns the track names.

        Calling it is never needed.
        """
        assets = find_assets(graphics=with_graphics)
        if use_subprocess and not with_graphics and can_fork():
            start_fork_server(assets.root)
        return list(assets.tracks)

    @property
    def num_kart(self) -> int:
        """Number of karts in the race."""
        return self.core.options.num_kart

    @property
    def default_track(self) -> str | Sequence[str] | None:
        """The track that was asked for; ``None`` for any."""
        return self.core.options.track

    @property
    def current_track(self) -> str | None:
        """Name of the present race's track; ``None`` before the first reset."""
        return self.core.race.track if self.core.race else None

    @property
    def track(self) -> TrackMap | None:
        """The present race's track; ``None`` before the first reset."""
        return self.core.track_map

    @property
    def world(self) -> WorldView | None:
        """The present moment of the race; ``None`` before the first reset."""
        return self.world_update() if self.core.snapshot is not None else None

    def world_update(self, keep: bool = True) -> WorldView:  # noqa: ARG002 - as the reference
        """The present moment of the race."""
        if self.core.snapshot is None or self.core.race is None:
            raise ApiOrderError("there is no race before reset(); call reset() first")
        return WorldView.of(self.core.snapshot, self.core.race.kart_types)

    def render(self) -> Any:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.render`."""
        return self.core.render()

    def frames(self) -> dict[str, npt.NDArray[np.uint8]]:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.frames`."""
        return self.core.frames()

    def close(self) -> None:
        """Ends the game's process; ``reset`` may be called again."""
        self.core.close()

    def save_state(self) -> RaceState:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.save_state`.

        What wrappers around this environment count, as ``TimeLimit`` does, is not in it.
        """
        state = self.core.save_state()
        state.front = self._front()
        return state

    def restore_state(self, state: RaceState) -> None:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.restore_state`."""
        self.core.restore_state(state)
        self._go_on(state.front)

    def clone(self: _Self) -> _Self:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.clone`."""
        make: Any = type(self)
        twin: _Self = make(*self._ezpickle_args, **self._ezpickle_kwargs)
        twin.core.follow(self.core)
        twin._go_on(self._front())
        return twin

    @contextlib.contextmanager
    def lookahead(self: _Self) -> Iterator[_Self]:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.lookahead`."""
        branch = self.clone()
        try:
            yield branch
        finally:
            branch.close()

    def _go_on(self, front: Any) -> None:
        self.np_random = self.core.np_random
        self._recall(front)

    def _front(self) -> Any:
        """What this environment remembers beside the core, as a value."""
        return None

    def _recall(self, front: Any) -> None:
        """Remembers what :meth:`_front` gave; with ``None``, what the core knows."""

    def _seed_core(self, seed: int | None) -> None:
        """Makes the core draw from this environment's stream, as Gymnasium seeds it."""
        gym.Env.reset(self, seed=seed)
        self.core.np_random = self.np_random
