"""The points of the tissue that a scene's tools touch, and where they are later."""

import numpy as np

from tissue_sim.contact.scene import Scene


class Touching:
    """Part of a test's scene with a gripper; `scene` is the scene."""

    scene: Scene

    def touched(self):
        """Nodes and weights of the points that touch."""
        state = self.scene.simulation.state
        pressed = np.flatnonzero(state.contact_pressed[0, : state.contacts.header.points] > 0.0)
        return state.contacts.node[pressed].copy(), state.contacts.weight[pressed].copy()

    def points(self, touched):
        """Where those points are now, (k, 3) m."""
        return np.einsum("ij,ijk->ik", touched[1], self.scene.simulation.positions[touched[0]])
