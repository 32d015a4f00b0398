"""The render session without a game."""

from pathlib import Path

import numpy as np
import pytest

from stkzoo.engine import wire
from stkzoo.engine.process import RaceProcess
from stkzoo.engine.render_session import RenderSession
from stkzoo.errors import ApiOrderError


class _NoLog:
    def close(self):
        pass


class _SilentProcess(RaceProcess):
    """A process that never answers."""

    def drop(self):
        self.connection.close()


def test_an_interrupted_request_ends_the_process(monkeypatch):
    ours, theirs = wire.pair()
    session = RenderSession(Path("/nowhere"), (64, 48))
    session._process = _SilentProcess(ours, 1, _NoLog())
    session._timeouts[wire.DRAW] = 1.0

    def interrupted(_kind):
        raise KeyboardInterrupt

    monkeypatch.setattr(session, "_receive", interrupted)
    poses = np.zeros((1, 1, 8), np.float32)
    with pytest.raises(KeyboardInterrupt):
        session.draw(poses)
    theirs.close()
    assert session.pid is None
    with pytest.raises(ApiOrderError, match="the render process has ended or was not started"):
        session.draw(poses)
