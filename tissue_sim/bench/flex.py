"""The same organ as a MuJoCo flex: linear tetrahedra of its nodes, its tissue, its held nodes."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from tissue_sim.array_types import Floats
from tissue_sim.bench.timing import time_calls
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.winding import inside

STEP = 0.001  # s
DAMPING = 0.01  # s, stiffness-proportional; without damping the organ keeps oscillating
_SLIVER = 1e-3  # volume over cube of the longest edge, below which a tetrahedron is left out


class Flex:
    """Bursts of steps of the organ in MuJoCo, under forces on nodes.

    The integrator is `discrete` with conjugate gradients: MuJoCo integrates a flex's elasticity implicitly with no
    other, and its explicit one diverges here even at 0.05 ms.

    nodes (k,): loaded nodes; forces (k, 3) N: forces on them; filling: points (p, 3) m, the organ's surface first, and
    tetrahedra (c, 4), instead of Delaunay's of the organ's nodes; step: time step, s; damping: damping proportional to
    stiffness, s. Raises ModuleNotFoundError without mujoco; UserError where it can't load the organ.
    """

    def __init__(
        self,
        organ: Organ,
        nodes: NDArray[np.int64],
        forces: Floats,
        *,
        filling: tuple[Floats, NDArray[np.int32]] | None = None,
        step: float = STEP,
        damping: float = DAMPING,
    ) -> None:
        import mujoco

        self._step = mujoco.mj_step
        # Else it would write its warnings to a file in the working folder.
        mujoco.set_mju_user_warning(self._note)
        self.warnings: list[str] = []
        points, cells = filling or (organ.rest_positions, tetrahedra(organ))
        self.rest = points
        self.n_tetrahedra = len(cells)
        try:
            self.model = mujoco.MjModel.from_xml_string(scene_xml(organ, points, cells, step, damping))
        except ValueError as error:
            raise UserError(f"MuJoCo does not load '{organ.name}': {str(error).splitlines()[0]}") from None
        self._reset = mujoco.mj_resetData
        self.data = mujoco.MjData(self.model)
        self.load(nodes, forces)

    def load(self, nodes: NDArray[np.int64], forces: Floats) -> None:
        """Return to the rest shape, under forces (k, 3) N on nodes (k,)."""
        self._reset(self.model, self.data)
        self.data.xfrc_applied[self.model.flex_vertbodyid[nodes], :3] = forces

    def _note(self, message: str) -> None:
        self.warnings.append(message)

    def __call__(self, count: int) -> Floats:
        """Return the seconds (count,) of `count` steps."""
        return time_calls(lambda: self._step(self.model, self.data), count)

    def step(self) -> float:
        """Do a step; return its seconds."""
        start = time.thread_time()
        self._step(self.model, self.data)
        return time.thread_time() - start

    @property
    def positions(self) -> Floats:
        """Positions (n, 3) m at the beginning of the last step."""
        return np.asarray(self.data.flexvert_xpos).reshape(-1, 3)


def tetrahedra(organ: Organ) -> NDArray[np.int32]:
    """Return Delaunay tetrahedra (c, 4) of all nodes inside the organ, positively oriented, without slivers."""
    points = organ.rest_positions
    cells = Delaunay(points).simplices
    cells = cells[inside(points[cells].mean(axis=1), organ.surface_positions, organ.surface_triangles)]
    side = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.linalg.det(side) / 6.0
    cells[volume < 0.0] = cells[volume < 0.0][:, [0, 2, 1, 3]]
    longest = np.linalg.norm(side, axis=2).max(axis=1)
    return cells[np.abs(volume) > _SLIVER * longest**3].astype(np.int32)


def scene_xml(organ: Organ, points: Floats, cells: NDArray[np.int32], step: float, damping: float) -> str:
    """Return MuJoCo's description of the organ with points (p, 3) m and cells (c, 4): no gravity, no contacts."""
    places = " ".join(f"{value:.9g}" for value in points.ravel())
    return f"""<mujoco>
  <option timestep="{step}" integrator="discrete" solver="CG" gravity="0 0 0"/>
  <size memory="256M"/>
  <worldbody>
    <flexcomp name="organ" type="direct" dim="3" mass="{organ.mass.sum():.9g}" radius="0.0005"
        point="{places}" element="{" ".join(map(str, cells.ravel()))}">
      <edge equality="false"/>
      <elasticity young="{organ.youngs_modulus:.9g}" poisson="{organ.poisson_ratio:.9g}" damping="{damping}"/>
      <contact selfcollide="none" contype="0" conaffinity="0"/>
      <pin id="{" ".join(map(str, organ.fixed))}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
