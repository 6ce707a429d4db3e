"""Fixtures of the tests that talk to real nodes."""

from collections.abc import Callable, Iterator

import pytest

from helpers.ros.clients import Client
from helpers.ros.processes import Process, start_node
from tissue_sim.ros.shared import client


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


@pytest.fixture
def graph():
    """The rclpy node of a viewer."""
    with client.client_node("viewer", "tissue_sim") as node:
        yield node


@pytest.fixture
def open_page(graph):
    """Opens the page of tools, without a browser; it is closed with the test."""
    from helpers.ros.page import Page  # needs viser

    opened = []

    def one(*tools: str) -> Page:
        opened.append(Page(graph, *tools))
        return opened[-1]

    yield one
    for page in opened:
        page.close()


@pytest.fixture(name="client")
def hand() -> Iterator[Client]:
    """A client that sends poses and feels wrenches, without markers."""
    made = Client(markers=False)
    yield made
    made.close()
