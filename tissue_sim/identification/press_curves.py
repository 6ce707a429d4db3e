"""Force curves of the real-time model along measured presses."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Array, Floats
from tissue_sim.errors import UserError
from tissue_sim.identification.force_curves import ForceCurves, tabulated
from tissue_sim.identification.measured import MeasuredPress, Measurement
from tissue_sim.identification.places import flat_locations
from tissue_sim.identification.pressing import Path, Press, ball, forces, moving_forces
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.tool_resolution import unresolved_tools_of

KNOTS = 22  # depths of a curve at which the model is held
REACH = 0.8e-3  # m, by which a curve goes beyond the deepest sample, for contact offsets
ASTRAY = 0.004  # m, distance of tool and surface at the first contact, beyond which the registration is wrong
FAST = 0.01  # m/s, from which a press is simulated at its own speed, instead of being held at each depth

Arrays = dict[str, Array]
Remember = Callable[[str, Callable[[], Arrays]], Arrays]


class RecordedPath(NamedTuple):
    """Path of a measured press, straight beyond what was recorded."""

    place: Floats
    direction: Floats
    depths: Floats
    drift: Floats

    def at(self, deep: float) -> Floats:
        """Return the tool's middle at a depth, m."""
        aside = [float(np.interp(deep, self.depths, column)) for column in self.drift.T]
        return np.asarray(self.place + deep * self.direction + np.array(aside))


def forget(name: str, make: Callable[[], Arrays]) -> Arrays:
    """Return the arrays that `make` returns, and keep nothing."""
    return make()


def check_tool(organ: Organ, radius: float) -> None:
    """Raise UserError, with the number of points that would do, for a tool too small for an organ's edges."""
    if reason := unresolved_tools_of(organ, radius):
        raise UserError(f"presses of this tool can't be identified: {reason}")


def check_registration(organ: Organ, measurement: Measurement) -> None:
    """Raise UserError for a press that doesn't begin at the organ's surface."""
    presses = measurement.presses
    places = np.array([press.place for press in presses])
    away = distance_to_surface(places, organ.surface_positions, organ.surface_triangles) - measurement.radius
    worst = int(np.abs(away).argmax())
    if abs(away[worst]) > ASTRAY:
        raise UserError(
            f"{presses[worst].name} begins {1e3 * abs(away[worst]):.1f} mm from the surface of organ '{organ.name}':"
            " the poses are not in its axes, or in another unit; register them, or press anywhere with --unplaced"
        )


def curves_of(
    organ: Organ,
    measurement: Measurement,
    friction: float,
    factor: float = 1.0,
    remember: Remember = forget,
    knots: int = KNOTS,
) -> ForceCurves:
    """Return the model's force curves for the organ's own modulus.

    The statics of a neo-Hookean organ are linear in a factor on its moduli, so that one run of each press gives its
    forces for all of them. Presses without a place share the mean of three spots where the organ is flat.

    Parameters
    ----------
    organ : Organ
        The organ.
    measurement : Measurement
        Presses that all have places, or none.
    friction : float
        Coefficient of friction between tool and tissue.
    factor : float, optional
        Factor on the moduli with which fast presses, where inertia and damping count, are simulated.
    remember : Remember, optional
        Keeps results by name, so that the calculation can be continued.
    knots : int, optional
        Number of depths at which the model is held.

    Returns
    -------
    ForceCurves
        One curve for each press, or one for all.

    Raises
    ------
    UserError
        For a tool too small for the organ, and for presses that miss it.
    """
    check_tool(organ, measurement.radius)
    presses = measurement.presses
    scene = ball(organ, measurement.radius, friction)
    scene.simulation.settings.stiffness_scale = factor
    scene.set_substeps()

    def kept(path: Path, depths: Floats, speed: float) -> Floats:
        def make() -> Arrays:
            force = moving_forces(scene, path, depths, speed) if speed else forces(scene, path, depths)
            return {"force": force / factor}

        known = [*path, depths, [measurement.radius, friction, speed, factor]]  # type: ignore[misc]
        text = repr([np.asarray(one).tolist() for one in known])
        return remember(hashlib.sha256(text.encode()).hexdigest()[:16], make)["force"]

    if not measurement.is_registered:
        deepest = max(press.deepest for press in presses) + REACH
        depths = np.linspace(0.0, deepest, knots)
        spots = flat_locations(organ, 1)[0]
        paths = [Press(spot.point - measurement.radius * spot.direction, spot.direction) for spot in spots]
        force = [kept(path, depths, 0.0) for path in progress.steps(paths, "presses of the model")]
        return tabulated([depths], [np.mean(force, axis=0)], np.zeros(len(presses), dtype=np.int64))
    check_registration(organ, measurement)
    every, found = [], []
    for press in progress.steps(presses, "presses of the model"):
        depths = np.linspace(-REACH, press.deepest + REACH, knots)
        found.append(kept(_path_of(press), depths, press.speed if press.speed > FAST else 0.0))
        every.append(depths)
    return tabulated(every, found, np.arange(len(presses)))


def _path_of(press: MeasuredPress) -> RecordedPath:
    order = np.argsort(press.depths, kind="stable")
    drift = press.drift[order] if len(press.drift) else np.zeros((len(order), 3))
    return RecordedPath(press.place, press.direction, press.depths[order], drift)
