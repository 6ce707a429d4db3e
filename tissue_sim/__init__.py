"""Real-time deformable organs for haptics and CI: the hybrid elastic model of Zhang, Gu et al. (2006)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissue_sim.version import __version__ as __version__

if TYPE_CHECKING:
    from tissue_sim.calibration.api import calibrate
    from tissue_sim.contact.attachments import Attachment, Breathing
    from tissue_sim.contact.scene import Scene
    from tissue_sim.contact.scene_batch import SceneBatch
    from tissue_sim.contact.scene_file import load_scene
    from tissue_sim.contact.tools import Tool
    from tissue_sim.errors import UserError
    from tissue_sim.model.simulation import Simulation
    from tissue_sim.organ.build import build
    from tissue_sim.organ.organ import Organ
    from tissue_sim.organ.placement import placed
    from tissue_sim.ros.bags.reading import Bag, read_bag

__all__ = [
    "Attachment",
    "Bag",
    "Breathing",
    "Organ",
    "Scene",
    "SceneBatch",
    "Simulation",
    "Tool",
    "UserError",
    "build",
    "calibrate",
    "load_scene",
    "placed",
    "read_bag",
]

# The module of each public name. It is imported when the name is first asked for (PEP 562): NumPy, Numba and the mesh
# libraries take a second together, and the command line needs none of them to answer.
_MODULES = {
    "Attachment": "tissue_sim.contact.attachments",
    "Bag": "tissue_sim.ros.bags.reading",
    "Breathing": "tissue_sim.contact.attachments",
    "Organ": "tissue_sim.organ.organ",
    "Scene": "tissue_sim.contact.scene",
    "SceneBatch": "tissue_sim.contact.scene_batch",
    "Simulation": "tissue_sim.model.simulation",
    "Tool": "tissue_sim.contact.tools",
    "UserError": "tissue_sim.errors",
    "build": "tissue_sim.organ.build",
    "calibrate": "tissue_sim.calibration.api",
    "load_scene": "tissue_sim.contact.scene_file",
    "placed": "tissue_sim.organ.placement",
    "read_bag": "tissue_sim.ros.bags.reading",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module 'tissue_sim' has no attribute '{name}'")
    import importlib

    value = globals()[name] = getattr(importlib.import_module(_MODULES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
