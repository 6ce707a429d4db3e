"""Model of how an organ deforms: no files, no ROS."""

from tissue_sim.model.simulation import Simulation

__all__ = ["Simulation"]
