"""Parameters of a simulation that may change between two ticks."""

from __future__ import annotations

from enum import IntEnum

from tissue_sim.model.data.records import Record


class Integrator(IntEnum):
    """Time integration of the nodes."""

    SYMPLECTIC, EXPLICIT = range(2)


class LocalRegion(IntEnum):
    """Which nodes move under a small load."""

    OFF, FROZEN, MODAL, AUTO = range(4)


INTEGRATORS = tuple(one.name.lower() for one in Integrator)
LOCAL_REGIONS = tuple(one.name.lower() for one in LocalRegion)


class Settings(Record):
    """Fields of `Simulation.settings`."""

    tick_time: float  # s
    friction: float  # Coulomb coefficient
    toughness: float  # J/m^2, energy that a blade needs for new area
    flank_friction: float  # Pa of a blade's flanks in a cut
    force_clamp: float  # N
    force_slew: float  # N/s, fastest change of the haptic output
    stale_time: float  # s
    ramp_time: float  # s
    stiffness_scale: float
    damping_scale: float
    region_force: float  # N above which the region is skipped
    region_inertia: float  # factor on mass and damping of a modal region, so that it doesn't need additional substeps
    runaway_span: float  # m, displacement from which the guard assumes a runaway
    coupling_stiffness: float  # N/m between a body and the pose in which it is held; 0: rigid
    coupling_damping: float  # N s/m on the tool
    gravity_x: float  # m/s^2, in the organ's frame
    gravity_y: float
    gravity_z: float
    substeps: int  # in a tick, from the critical step
    least_substeps: int  # number that links require of all organs that they join
    region_substeps: int  # in a tick of a local region
    integrator: int  # Integrator
    local_region: int  # LocalRegion


def default_settings(tick_time: float, local_region: str, integrator: str) -> Settings:
    """Return the settings of a simulation, except for those that depend on its organ.

    Parameters
    ----------
    tick_time : float, s
        Duration of a tick.
    local_region : str
        One of LOCAL_REGIONS.
    integrator : str
        One of INTEGRATORS.
    """
    made = Settings.new()
    made.tick_time = tick_time
    made.friction, made.toughness, made.flank_friction = 0.6, 120.0, 500.0
    made.force_clamp, made.force_slew = 10.0, 1e3
    made.stale_time, made.ramp_time = 0.05, 0.02
    made.stiffness_scale = made.damping_scale = 1.0
    made.region_force = 0.3
    made.local_region, made.integrator = LocalRegion[local_region.upper()], Integrator[integrator.upper()]
    return made
