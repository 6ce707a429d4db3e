"""The organ as a MuJoCo flex that a ball presses, for `tissue_sim bench batch`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench.flex import DAMPING, scene_xml, tetrahedra
from tissue_sim.organ.organ import Organ

if TYPE_CHECKING:
    import mujoco


class PressedFlex:
    """Copies of an organ in MuJoCo, each with a ball that follows given positions.

    radius: radius of the ball, m; step: MuJoCo's time step, s; copies: how many. Raises ModuleNotFoundError without
    mujoco.
    """

    def __init__(self, organ: Organ, radius: float, step: float, copies: int) -> None:
        import mujoco

        self._mujoco = mujoco
        mujoco.set_mju_user_warning(lambda message: None)  # else it would write a file in the working folder
        xml = scene_xml(organ, organ.rest_positions, tetrahedra(organ), step, DAMPING)
        xml = xml.replace('contype="0" conaffinity="0"', 'contype="1" conaffinity="1"')
        ball = f'<body name="ball" mocap="true" pos="1 0 0"><geom type="sphere" size="{radius:.9g}"/></body>'
        self._model = mujoco.MjModel.from_xml_string(xml.replace("<worldbody>", f"<worldbody>{ball}"))
        self._data = [mujoco.MjData(self._model) for _ in range(copies)]

    def step(self, copies: Sequence[int], places: Floats, steps: int) -> None:
        """Move the balls of copies (k,) to places (n, 3) m, and do so many steps of each."""
        for copy in copies:
            self._data[copy].mocap_pos[0] = places[copy]
            self._mujoco.mj_step(self._model, self._data[copy], steps)

    @property
    def forces(self) -> Floats:
        """Force of the contacts of each copy, (n,) N."""
        return np.array([np.linalg.norm(self._force(data)) for data in self._data])

    def _force(self, data: mujoco.MjData) -> Floats:
        total, each = np.zeros(3), np.zeros(6)
        for contact in range(data.ncon):
            self._mujoco.mj_contactForce(self._model, data, contact, each)
            total += data.contact[contact].frame.reshape(3, 3).T @ each[:3]
        return total
