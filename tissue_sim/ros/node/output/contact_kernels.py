"""Command `python -m tissue_sim.ros.node.output.contact_kernels ORGAN`: compiles the kernels of contact sets to disk.

A node that starts for the first time runs it beside itself while it compiles its tick: one process compiles one kernel
at a time.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.pressed_points import warm_up
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.shared.children import Child
from tissue_sim.unexpected_errors import catch_all


def compile_beside(organ_file: Path) -> Child:
    """Start it as a process that ends with this one. Where it fails, the node compiles for itself."""
    return Child("contact kernels", [sys.executable, "-m", __name__, str(organ_file)], os.environ)


def main(organ_file: str) -> None:
    """Search contacts of one tool once: kernels are the same for any organ and any tools."""
    organ = Organ.load(organ_file)
    finder = ContactFinder(organ, ToolSet([Tool("left")]))
    finder.warm_up(organ.rest_positions)
    warm_up(finder.tools.shapes)


if __name__ == "__main__":
    catch_all("contact_kernels")
    main(sys.argv[1])
