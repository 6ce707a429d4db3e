"""The gripper of config/instruments on bars of cells: the force at which they slip, and no creep below it.

It is drawn out across a bar whose sides are parallel, and its fingers are longer than the bar is high: neither a wedge
nor an edge adds to friction. While it slides, the force is that of Coulomb: the coefficient times the sum of the normal
forces of both fingers.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.bars import bar
from tissue_sim.bench.grasp import Touching
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.organ import Organ

FINGERS = ("finger", "opposite_finger")
# Columns: the tool's x axis closes across the bar, its z axis looks down, through the bar's height.
TURN = Rotation.from_matrix(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).T).as_quat()
BEYOND = 0.014  # m that the fingers reach beyond the bar's lower side
FROM_END = 0.02  # m from the bar's free end to the fingers' middle
SPEED = 0.005  # m/s of the pull


class Bar(NamedTuple):
    """A bar that is grasped: its organ, a factor on its stiffness, friction, and the compression of its width."""

    organ: Organ
    stiffness: float
    friction: float
    squeeze: float


BARS = {
    "soft": Bar(bar(8, 0.005, 4), 1.0, 0.3, 0.10),
    "stiff": Bar(bar(8, 0.005, 4), 4.0, 0.15, 0.06),
    "slender": Bar(bar(12, 0.004, 4), 2.0, 0.2, 0.08),
}


class Grasped(Touching):
    """The gripper, closed on a bar near its free end."""

    def __init__(self, chosen: Bar) -> None:
        points = chosen.organ.surface_positions
        low, high = points.min(axis=0), points.max(axis=0)
        width = high[1] - low[1]
        tool = Tool(
            "left",
            "urdf",
            mesh="config/instruments/two_finger.urdf",
            links=FINGERS,
            tip_link="tip",
            jaw_joint="opening",
        )
        self.scene = Scene(chosen.organ, [tool], stiffness=[chosen.stiffness])
        self.scene.simulation.settings.friction = chosen.friction
        self.scene.simulation.settings.force_clamp = 100.0
        self.at = np.array([high[0] - FROM_END, 0.5 * (low[1] + high[1]), low[2] - BEYOND])
        self.opening = 0.5 * width + 0.004
        self.lead(200)
        for opening in np.linspace(self.opening, 0.5 * width * (1.0 - chosen.squeeze), 400):
            self.opening = opening
            self.lead()
        self.lead(200)

    def lead(self, ticks=1, by=0.0):
        """Go on for some ticks, in each of which the gripper is drawn out by m."""
        for _ in range(ticks):
            self.at[2] += by
            self.scene.move(0, self.at, TURN, self.opening)
            self.scene.step()

    @property
    def pull(self):
        """Force against being drawn out, N, and the sum of the fingers' normal forces, N."""
        of_fingers = self.scene.simulation.state.wrench[:, :3]
        return -float(of_fingers[:, 2].sum()), float(np.abs(of_fingers[:, 1]).sum())

    def slide(self, way):
        """Draw the gripper out by a way, m; pull and normal force of each tick, (k, 2) N."""
        found = []
        for _ in range(round(1e3 * way / SPEED)):
            self.lead(by=1e-3 * SPEED)
            found.append(self.pull)
        return np.array(found)


EXTENDED = [pytest.param(name, marks=[] if name == "soft" else pytest.mark.extended) for name in BARS]


@pytest.mark.parametrize("name", EXTENDED)
def test_it_slips_at_coulombs_force(name):
    grasped, friction = Grasped(BARS[name]), BARS[name].friction
    grasped.slide(0.006)  # until the fingers have slipped
    pull, normal = grasped.slide(0.006).T
    off = pull.mean() / (friction * normal.mean()) - 1.0
    print(f"{name}: slides at {pull.mean():.4f} N, {100.0 * off:+.1f} % of {friction} x {normal.mean():.4f} N")
    assert abs(off) < 0.05


@pytest.mark.parametrize("name", EXTENDED)
@pytest.mark.parametrize("seconds", [1.0, pytest.param(60.0, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_below_it_is_held_without_creep(name, seconds):
    grasped, friction = Grasped(BARS[name]), BARS[name].friction
    while (forces := grasped.pull)[0] < 0.5 * friction * forces[1]:
        grasped.lead(by=1e-3 * SPEED)
    grasped.lead(500)
    held = grasped.touched()
    before = grasped.points(held)
    grasped.lead(round(1e3 * seconds))
    crept = float(np.linalg.norm(grasped.points(held) - before, axis=1).max())
    pull, normal = grasped.pull
    print(f"{name}: {seconds:g} s at {pull / (friction * normal):.2f} of the slip force: crept {1e6 * crept:.3f} um")
    assert len(held[0]) > 10
    assert pull > 0.4 * friction * normal
    assert crept < 1e-5
    grasped.scene.simulation.settings.friction = 0.3 * friction
    grasped.lead(300)
    assert np.linalg.norm(grasped.points(held) - before, axis=1).max() > 1e-4, "too little friction would be seen"
