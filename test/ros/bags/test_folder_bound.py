"""Bags are made below the folder that the node was started with, whatever anybody asks for."""

import os

import pytest

from helpers.ros.clients import Client
from helpers.ros.processes import running_node
from tissue_sim.errors import UserError
from tissue_sim.ros.bags.folder_bound import Bound


@pytest.fixture
def places(tmp_path, monkeypatch):
    """A working directory with the bound `bags`, in it a folder, a link out and one that stays, beside it `bags2`."""
    (tmp_path / "bags" / "ward").mkdir(parents=True)
    (tmp_path / "bags2").mkdir()
    (tmp_path / "bags" / "out").symlink_to(tmp_path / "bags2")
    (tmp_path / "bags" / "in").symlink_to("ward")
    (tmp_path / "bags" / "loop").symlink_to("loop")
    monkeypatch.chdir(tmp_path)
    return tmp_path


ALLOWED = ["bags", "bags/", "bags/ward", "bags/new/deep", "bags/in/deep", "bags/ward/../ward", "bags2/../bags/ward"]
REFUSED = [
    "",
    ".",
    "/",
    "/etc",
    "bags2",
    "bags/..",
    "bags/../bags2",
    "bags/new/../../bags2",
    "bags/out",
    "bags/out/deep",
]
REFUSED += ["bags/in/../../bags2", "bags/loop/deep", "bags/a\0b", "~/bags", "ward"]


@pytest.mark.parametrize("folder", ALLOWED)
def test_a_folder_below_is_allowed(places, folder):
    bound = Bound("bags")
    for name in (folder, f"{places}/{folder}"):
        found = bound.inside(name)
        assert str(found) == os.path.realpath(places / folder)
        assert found.is_relative_to(places / "bags")


@pytest.mark.parametrize("folder", REFUSED)
def test_what_leads_out_is_refused_in_one_line(places, folder):
    with pytest.raises(UserError, match="record_folder") as refused:
        Bound("bags").inside(folder)
    assert "\n" not in str(refused.value)


def test_a_bound_that_is_a_link_holds_where_it_leads(places):
    (places / "big").symlink_to(places / "bags2")
    bound = Bound("big")
    assert bound.inside("big/deep") == places / "bags2" / "deep"
    with pytest.raises(UserError):
        bound.inside("bags")


@pytest.mark.extended
def test_a_node_makes_no_bag_elsewhere(places):
    with running_node(places, "rate:=100.0", "record_folder:=bags") as node:
        client = Client()
        try:
            assert not client.set_parameter("record_folder", 5).successful
            for folder in ("bags2", "bags/../bags2", "bags/out", f"{places}"):
                refused = client.set_parameter("record_folder", folder)
                assert not refused.successful
                assert "outside" in refused.reason
                assert "\n" not in refused.reason
            assert client.set_parameter("record_folder", "bags/ward").successful
            assert client.record(True).message.startswith(f"{places}/bags/ward/tissue_sim-")
            assert client.record(False).success
            # One that was allowed, and is a link out of it by now.
            assert client.set_parameter("record_folder", "bags/new").successful
            (places / "bags" / "new").symlink_to(places / "bags2")
            answer = client.record(True)
            assert not answer.success
            assert "outside" in answer.message
        finally:
            client.close()
        assert not list((places / "bags2").iterdir())
        assert node.says("surface nodes")
