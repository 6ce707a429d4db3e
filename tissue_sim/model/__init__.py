"""Deformable model of an organ, without files and ROS."""

from tissue_sim.model.simulation import Simulation

__all__ = ["Simulation"]
