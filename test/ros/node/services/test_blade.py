"""A blade at a node: it cuts the organ as it is moved, its cut is published, and its bag repeats."""

import time
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from scipy.spatial.transform import Rotation

from helpers.ros.clients import LATCHED, Client
from helpers.ros.processes import UNHURRIED, running_node, shipped
from helpers.ros.replaying import repeated
from tissue_sim.ros.bags.recording import Recording

LIMIT = 600.0  # s, as the cut is made at a low priority, which waits long for a turn on a busy machine
STEP = 1e-4  # m
# The edge, -z of the tool, lies along x of the organ, and cuts along y into its lateral side.
TURN = Rotation.from_matrix(np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])).as_quat()
BLADE = ("left.shape:=blade", "left.radius:=0.0005", "left.length:=0.02", "toughness:=30.0")
HOT = ("left.cautery_speed:=0.05", "left.cautery_stiffening:=20.0", "left.cautery_spread:=0.003")


class Surgeon(Client):
    """A client that moves the blade and hears what becomes of the organ."""

    def __init__(self):
        super().__init__()
        self.events = []
        self.node.create_subscription(DiagnosticArray, f"{self.target}/cuts", self.events.append, LATCHED)
        side = shipped().surface_positions
        lowest = side[np.argmin(side[:, 1])]
        self.start = np.array([lowest[0] - 0.01, lowest[1], lowest[2]])

    @property
    def cuts(self):
        return self.events[-1].status if self.events else []

    def hold(self, depth):
        self.ask(self.start + [0.0, depth, 0.0], quaternion=TURN)


@pytest.mark.parametrize(
    "heat", [(), pytest.param(HOT, marks=pytest.mark.extended)], ids=["a knife", "a hook that stiffens its walls"]
)
def test_a_blade_cuts_as_it_is_moved_and_its_bag_repeats(tmp_path, capsys, heat):
    with running_node(tmp_path, "tools:=[left]", *BLADE, *heat, UNHURRIED, f"record_folder:={tmp_path / 'bags'}"):
        client = Surgeon()
        assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.surface().size > 0)
        bags = [client.record(True).message]
        deep, end = -0.004, time.monotonic() + LIMIT
        forces = []
        while not (client.cuts and client.report()["cuts"] == "1" and deep > 0.014):
            assert time.monotonic() < end, client.diagnostics
            deep = min(deep + STEP, 0.016)
            client.hold(deep)
            if client.wrenches:
                forces.append(-client.wrenches[-1][1][1])
        assert heat or max(forces) > 0.3
        (status,) = client.cuts
        values = {item.key: float(item.value) for item in status.values}
        assert values["area_m2"] > 5e-6  # of the newest stage that was opened
        assert bool(values["stiffer_cells"]) == bool(heat)
        # Another bag begins in the cut organ; whether the blade sticks at that moment depends on the machine.
        assert client.record(False).success
        bags.append(client.record(True).message)
        while deep < 0.018:
            deep += STEP
            client.hold(deep)
        while deep > -0.006:
            deep -= 4.0 * STEP
            client.hold(deep)
        assert client.spin_until(lambda: client.hand_force() < 1e-3)
        client.spin(0.3)
        assert client.record(False).success
        assert client.reset().success
        assert client.spin_until(lambda: not client.cuts)
        client.close()
    for bag in bags:
        repeated(bag, capsys)
    (organ,) = Recording.read(Path(bags[1])).organs
    assert organ.cuts[0].tick == -1, "it was cut before"
    assert (organ.cuts[0].organ.cell_mu.max() > 2.0 * shipped().cell_mu.max()) == bool(heat)
