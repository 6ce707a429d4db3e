"""A ROS graph of its own for every test session: a free domain that reaches no further than this machine."""

import importlib.util
import os
import sys

import pytest

from helpers.cluster import cluster_in
from helpers.paths import ROOT
from tissue_sim.errors import UserError
from tissue_sim.progress_reporter import SETTING
from tissue_sim.ros.shared.domains import claim_domain


def pytest_configure(config: pytest.Config) -> None:
    """Set the environment before any test imports rclpy; child processes inherit it."""
    try:
        domain, claim = claim_domain()
    except UserError as error:
        raise pytest.UsageError(str(error)) from None
    config.add_cleanup(claim.close)
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.pop("ROS_LOCALHOST_ONLY", None)
    os.environ[SETTING] = "0"  # on a busy machine a line would stand where a test counts lines

    # The wheels of ROS restart Python once to set LD_LIBRARY_PATH, and mark that in the environment. The mark without
    # the path comes from a parent process that dropped one of the two: rclpy would fail with a riddle.
    if importlib.util.find_spec("ros_wheels_bootstrapper") and f"{sys.prefix}/lib" not in os.environ.get(
        "LD_LIBRARY_PATH", ""
    ).split(os.pathsep):
        raise pytest.UsageError(
            "_ROS_WHEELS_BOOTSTRAP_COMPLETE is set but LD_LIBRARY_PATH lacks the ROS wheels; unset it and run again"
        )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What starts processes comes first: it takes long and waits, and would go on alone at the end."""
    items.sort(key=lambda item: not {"ros", "bench", "fuzz"} & set(item.path.parts))


@pytest.fixture
def helpers_on_path(monkeypatch):
    """Other processes find test/helpers, too."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "test"))


@pytest.fixture
def cluster(tmp_path, helpers_on_path):
    """Address of a Dask scheduler with two workers, and a client of it."""
    pytest.importorskip("distributed")
    with cluster_in(tmp_path) as found:
        yield found
