"""Fixtures for tests of races."""

import pytest


@pytest.fixture
def held():
    """A list of sockets that are closed after the test."""
    sockets = []
    yield sockets
    for one in sockets:
        one.close()
