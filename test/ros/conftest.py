"""Fixtures of the tests that talk to real nodes."""

from collections.abc import Callable, Iterator

import pytest
from processes import Process, start_node


@pytest.fixture
def start() -> Iterator[Callable[..., Process]]:
    """start_node, for nodes that end with the test at the latest, whatever comes of it."""
    started = []

    def one(*words, **named):
        started.append(start_node(*words, **named))
        return started[-1]

    yield one
    for process in started:
        process.child.kill()
        process.child.wait()
