"""Benchmark `tissue_sim bench palpation --places N`: force of a ball at nodes, on edges and inside triangles.

Balls whose radius is some mean edges of the organ's surface are pressed in at each, and don't slip; so are neo-Hookean
finite elements of the same shape, fine under the ball. Then they slide over the surface at constant depth: the ripple
of their force is what a hand feels of the mesh.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import tissue_sim
from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.palpation import FRICTION, Press, forces
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit, exit_code
from tissue_sim.calibration.cases import surface_of
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.squeeze import own_nodes, squeezed
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.fineness import FAIR, FAIR_WITHIN, FINE, FINE_WITHIN, mean_edge
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface

RADII = 0.5, 0.8, 1.0, 1.5, 2.0, 3.0  # mean edges
LEAST_RADIUS, MOST_RADIUS, MOST_PLACES = 0.2, 5.0, 100
DEPTHS = np.array([0.3, 0.5, 0.8, 1.0])  # radii
KINDS = {"node": (1.0, 0.0, 0.0), "edge": (0.5, 0.5, 0.0), "triangle": (1 / 3, 1 / 3, 1 / 3)}  # weights of corners
THROUGH = 0.35  # fraction of the organ's thickness there, to which a ball is pressed at most
CLEAR, AROUND = 5.0, 4.0  # edges from the clamp; edges around a place that should be flat
FLATTEST = 0.25  # fraction of the places that are clear of the clamp
ALIKE = 0.05  # tolerance of the least cosine between a place's normal and those around, below the flattest one's
STEPS = 2  # of the finite elements for each depth
ACROSS = 1.6  # least number of elements on a ball's radius
ELEMENTS = Grading(clamp=0, growth=1.0)  # places lie far from the clamp
FRICTIONS = 0.6, 0.0  # of a sliding ball: the node's default, and none
SLID_DEPTH = 0.5  # radii
RUN_IN, WAY = 1.0, 3.0  # edges of sliding before the force counts, and while it does
SLIDING, ENTERING = 0.01, 0.02  # m/s
OUTSIDE, PAUSE = 0.0005, 0.2  # m before it enters, s before it slides
KNOTS, ROUNDS = 25, 4  # knots of a track per edge; iterations to find its distance
MOST_RIPPLE = 5.0  # %
SLAB = np.array([0.06, 0.06, 0.025])  # m


class Spot(NamedTuple):
    """Spot where a ball is pressed in: number and kind of the place, (3,) m on the surface, inward direction (3,)."""

    place: int
    kind: str
    point: Floats
    way: Floats


class Pressed(NamedTuple):
    """Results of a ball at a spot: radius in mean edges; depths (d,) radii, forces (d,) N, nan where unsettled."""

    radius: float
    place: int
    kind: str
    depths: Floats
    ours: Floats
    reference: Floats

    @property
    def off(self) -> Floats:
        """Difference from the finite elements (d,), %."""
        return np.asarray(100.0 * (self.ours / self.reference - 1.0))


class Slid(NamedTuple):
    """Results of a sliding ball: radius in mean edges, mean force along the normal, N, and its ripple, % of that."""

    radius: float
    place: int
    friction: float
    force: float
    ripple: float


Reference = Callable[[Organ, Sequence[Spot], float, Floats], Floats]


def run(args: argparse.Namespace) -> int:
    """Press, slide, compare and print.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed arguments.

    Returns
    -------
    int
        Exit code: 0, or with --check 1 when a bound is missed.
    """
    radii = parse_radii(args.radii)
    if not 1 <= args.places <= MOST_PLACES:
        raise UserError(f"--places {args.places} is outside 1..{MOST_PLACES}")
    if args.slab and args.organ:
        raise UserError("--slab and an ORGAN are both given; choose one")
    if args.out:
        raise UserError("--out draws what a finger feels of a tumour; leave it out with --places")
    organ = slab() if args.slab else Organ.load(args.organ or shipped_organ())
    edge = mean_edge(organ)
    places = flat_places(organ, args.places)
    pressed: list[Pressed] = []
    slid: list[Slid] = []
    with rows.until_stopped():
        for press in presses(organ, radii, places):
            pressed.append(press)
            worst = np.nanmax(np.abs(press.off), initial=0.0)
            rows.tell(f"{press.radius:g} edges, place {press.place}, {press.kind}", f"off {worst:.1f} % at worst")
        for slide in slides(organ, radii, places):
            slid.append(slide)
            rows.tell(f"{slide.radius:g} edges, place {slide.place}, slid", f"ripple {slide.ripple:.1f} %")
    found = as_json(pressed, slid) | {"organ": organ.name, "edge_m": edge, "places": len(places)}
    emit(found, text(found), args.json)
    return exit_code(found, check=args.check)


def parse_radii(given: str | None) -> tuple[float, ...]:
    """Return the radii, mean edges, of a text like `0.5,1,2`. Raises UserError for what is none or out of range."""
    if given is None:
        return RADII
    try:
        radii = tuple(float(one) for one in given.split(","))
    except ValueError:
        raise UserError(f"--radii '{given}' are no numbers; write them as 0.5,1,2") from None
    for radius in radii:
        if not LEAST_RADIUS <= radius <= MOST_RADIUS:
            raise UserError(f"--radii {radius:g} is outside {LEAST_RADIUS:g}..{MOST_RADIUS:g} edges")
    return radii


# places --------------------------------------------------------------------------------------------


def flat_places(organ: Organ, count: int) -> list[list[Spot]]:
    """Return spots at a node, on an edge and in a triangle of so many triangles where the organ is flat.

    Clear of the clamp, among the flattest, and far from each other; the flattest comes first. Raises UserError where
    nothing is clear of the clamp.
    """
    surface, edge = surface_of(organ), mean_edge(organ)
    corner = surface.positions[organ.surface_triangles]
    middle = corner.mean(axis=1)
    way = surface.normal[organ.surface_triangles].mean(axis=1)
    way /= -np.linalg.norm(way, axis=1)[:, None]
    clear = np.full(len(middle), np.inf)
    if len(organ.fixed):
        clear = cKDTree(surface.positions[organ.fixed]).query(middle)[0]
    chosen = np.flatnonzero(clear > CLEAR * edge)
    if not len(chosen):
        raise UserError(
            f"organ '{organ.name}' has no place {1e3 * CLEAR * edge:.0f} mm from its clamp; use more points"
        )
    near = cKDTree(surface.positions).query_ball_point(middle[chosen], AROUND * edge)
    flat = np.array([(-surface.normal[nodes] @ way[one]).min() for one, nodes in zip(chosen, near, strict=True)])
    order = np.argsort(-np.round(flat, 2), kind="stable")[: math.ceil(FLATTEST * len(chosen))]
    candidates = chosen[order[flat[order] > flat.max() - ALIKE]]
    picked = [int(candidates[0])]
    while len(picked) < min(count, len(candidates)):
        apart = cKDTree(middle[picked]).query(middle[candidates])[0]
        picked.append(int(candidates[apart.argmax()]))
    return [
        [Spot(number, kind, np.array(weights) @ corner[one], way[one]) for kind, weights in KINDS.items()]
        for number, one in enumerate(picked)
    ]


def thickness(organ: Organ, spot: Spot) -> float:
    """Return the distance of the organ's other side from a spot, along its direction, m; inf where there is none."""
    corner = organ.surface_positions[organ.surface_triangles] - spot.point
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    across = np.cross(first, second)
    facing = across @ spot.way
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = np.einsum("tx,tx->t", across, corner[:, 0]) / facing
        sideways = np.cross(corner[:, 0], spot.way)
        shares = np.einsum("tx,tx->t", second, sideways) / facing, -np.einsum("tx,tx->t", first, sideways) / facing
    met = (facing > 0.0) & (ahead > 0.0) & (shares[0] >= 0.0) & (shares[1] >= 0.0) & (shares[0] + shares[1] <= 1.0)
    return float(ahead[met].min(initial=np.inf))


def slab() -> Organ:
    """Return a slab of 60 x 60 x 25 mm that lies on its clamp, built and calibrated with defaults in four minutes.

    It is kept in the user's cache.
    """
    from tissue_sim.bench.measured.body import calibrated
    from tissue_sim.store import user_cache

    folder = user_cache() / f"slab-{tissue_sim.__version__}"
    path = folder / "slab.npz"
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        calibrated(slab_as_built(), folder, progress.Stages())
    print(f"organ: {path}", file=sys.stderr)
    return Organ.load(path)


def slab_as_built() -> Organ:
    """Return the slab with the balloon's points and nothing fitted."""
    import trimesh

    from tissue_sim.organ.making import Request, organ_from_mesh
    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh

    box = trimesh.creation.box(SLAB)
    for _ in range(3):
        box = box.subdivide()
    mesh = SurfaceMesh(np.asarray(box.vertices), np.asarray(box.faces, dtype=np.int32), ())
    return organ_from_mesh(mesh, Request(name="slab", fixed="z<0.1"))


# pressing ------------------------------------------------------------------------------------------


def presses(
    organ: Organ, radii: Sequence[float], places: Sequence[Sequence[Spot]], reference: Reference | None = None
) -> Iterable[Pressed]:
    """Yield the forces of balls that are pressed in at all spots, beside the reference: finite elements if None.

    radii: mean edges. Raises UserError as Body does.
    """
    edge, reference = mean_edge(organ), reference or by_elements
    with progress.task("presses", len(radii) * sum(map(len, places))) as under_way:
        for radius in radii:
            scene = ball(organ, radius * edge, FRICTION)
            for spots in places:
                thick = min(thickness(organ, spot) for spot in spots)
                depths = DEPTHS[radius * edge * DEPTHS <= THROUGH * thick]
                wanted = reference(organ, spots, radius * edge, radius * edge * depths)
                for spot, one in zip(spots, wanted, strict=True):
                    press = Press(-1, spot.point - radius * edge * spot.way, spot.way)
                    ours = forces(scene, press, radius * edge * depths)
                    yield Pressed(radius, spot.place, spot.kind, depths, ours, one)
                    under_way.advance()


def ball(organ: Organ, radius: float, friction: float) -> Scene:
    """Return the organ and a ball, its radius in m."""
    scene = Scene(organ, [Tool("ball", radius=radius)], ticks_a_set=4)
    scene.simulation.settings.friction = friction
    return scene


def by_elements(organ: Organ, spots: Sequence[Spot], radius: float, depths: Floats) -> Floats:
    """Return the force (k, d) N of finite elements on a ball at spots (k,) of one place; nan where none settles.

    radius m; depths (d,) m, of which each is reached in steps. They are touched at all of their own nodes under it.
    """
    edge, middle = mean_edge(organ), np.mean([spot.point for spot in spots], axis=0)
    reach = max(1.1 * radius, 0.9 * edge) + max(np.linalg.norm(spot.point - middle) for spot in spots)
    near = np.linalg.norm(organ.surface_positions - middle, axis=1) < reach
    near[organ.fixed] = False
    fine = max(0, math.ceil(math.log2(ACROSS * edge / radius)))
    body = Body(organ, np.flatnonzero(near), ELEMENTS._replace(near=fine))
    centre = organ.surface_positions[organ.surface_triangles].mean(axis=1)
    found = np.full((len(spots), len(depths)), np.nan)
    deep = np.interp(np.arange(1, STEPS * len(depths) + 1) / STEPS, np.arange(len(depths) + 1), [0.0, *depths])
    for spot, row in zip(spots, found, strict=True):
        under = np.flatnonzero(np.linalg.norm(centre - spot.point, axis=1) < 1.1 * radius + edge)
        nodes = _beneath(body, own_nodes(body, under), spot, radius)
        path = spot.point - radius * spot.way + deep[:, None] * spot.way
        steps = squeezed(body.solid, nodes, path[:, None], radius)
        for number, step in enumerate(steps[STEPS - 1 :: STEPS]):
            if step.settled:
                row[number] = step.forces[0] @ spot.way
    return found


def _beneath(body: Body, nodes: Longs, spot: Spot, radius: float) -> Longs:
    """Return the nodes that a ball moving straight in can reach: fewer take less time."""
    away = body.solid.nodes[nodes] - spot.point
    beside = np.linalg.norm(away - np.outer(away @ spot.way, spot.way), axis=1)
    return nodes[beside < 1.1 * radius]


# sliding -------------------------------------------------------------------------------------------


class Track(NamedTuple):
    """Path of the centre of a sliding ball: m along, (k,); places (k, 3) m and outward normals (k, 3)."""

    along: Floats
    centres: Floats
    normals: Floats

    def at(self, along: Floats) -> tuple[Floats, Floats]:
        """Return places (n, 3) m and normals (n, 3) between the track's own."""
        found = [[np.interp(along, self.along, column) for column in of.T] for of in (self.centres, self.normals)]
        return np.transpose(found[0]), np.transpose(found[1])


def track_over(organ: Organ, spot: Spot, radius: float) -> Track:
    """Return the track over a spot on which a ball, its radius in m, lies SLID_DEPTH deep in the surface at rest.

    It follows a quadric through the nodes around, at a constant distance from the triangles: on a smooth track the ball
    would feel the shape of the facets, which finite elements have, too.
    """
    surface, edge, out = surface_of(organ), mean_edge(organ), -spot.way
    sideways = np.cross(out, [0.3, 1.0, 0.1])  # not an axis, which rows of a mesh might follow
    sideways /= np.linalg.norm(sideways)
    frame = np.array([sideways, np.cross(out, sideways), out])
    near = np.linalg.norm(surface.positions - spot.point, axis=1) < AROUND * edge
    near &= surface.normal @ out > 0.5
    x, y, z = ((surface.positions[near] - spot.point) @ frame.T).T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    level, slope, tilt, bend, twist, _ = np.linalg.lstsq(basis, z, rcond=None)[0]
    along = np.linspace(-RUN_IN - 0.5 * WAY, 0.5 * WAY, round(KNOTS * (RUN_IN + WAY))) * edge
    rise = np.stack([-slope - 2.0 * bend * along, -tilt - twist * along, np.ones_like(along)], axis=1)
    normals = rise @ frame / np.linalg.norm(rise, axis=1)[:, None]
    feet = np.stack([along, np.zeros_like(along), level + slope * along + bend * along**2], axis=1)
    wanted = (1.0 - SLID_DEPTH) * radius
    centres = spot.point + feet @ frame + wanted * normals
    for _ in range(ROUNDS):
        distance = distance_to_surface(centres, organ.surface_positions, organ.surface_triangles)
        centres = centres + (wanted - distance)[:, None] * normals
    return Track(along, centres, normals)


def slides(organ: Organ, radii: Sequence[float], places: Sequence[Sequence[Spot]]) -> Iterable[Slid]:
    """Yield the forces of balls that slide over the middle of each place, with every friction; radii: mean edges."""
    edge = mean_edge(organ)
    with progress.task("slides", len(radii) * len(FRICTIONS) * len(places)) as under_way:
        for radius in radii:
            for friction in FRICTIONS:
                scene = ball(organ, radius * edge, friction)
                for spots in places:
                    force = slid_force(scene, track_over(organ, spots[-1], radius * edge))
                    yield Slid(radius, spots[-1].place, friction, float(force.mean()), ripple(force))
                    under_way.advance()


def slid_force(scene: Scene, track: Track) -> Floats:
    """Return the force along the normal (k,) N at each tick after the run-in of a slide on a track."""
    scene.reset()
    tick, (begin, end) = scene.simulation.settings.tick_time, track.along[[0, -1]]

    def felt(centre: Floats, normal: Floats) -> float:
        scene.move(0, centre)
        scene.step()
        return float(scene.wrenches[0, :3] @ normal)

    first, normal = track.centres[0], track.normals[0]
    above = SLID_DEPTH * scene.tools.tools[0].radius + OUTSIDE
    for higher in np.linspace(above, 0.0, max(2, round(above / (ENTERING * tick)))):
        felt(first + higher * normal, normal)
    for _ in range(round(PAUSE / tick)):
        felt(first, normal)
    along = np.linspace(begin, end, max(2, round((end - begin) / (SLIDING * tick))))
    force = np.array([felt(*one) for one in zip(*track.at(along), strict=True)])
    return np.asarray(force[along >= begin + RUN_IN / (RUN_IN + WAY) * (end - begin)])


def ripple(force: Floats) -> float:
    """Return half the range of a force (k,) N about a parabola along the track, % of its mean.

    The parabola is the organ's: over a few edges its shape and its clamp change the force smoothly.
    """
    along = np.linspace(-1.0, 1.0, len(force))
    trend = np.polynomial.Polynomial.fit(along, force, 2)
    return float(50.0 * np.ptp(force - trend(along)) / force.mean())


# telling -------------------------------------------------------------------------------------------


def as_json(pressed: Sequence[Pressed], slid: Sequence[Slid]) -> dict[str, Any]:
    """Return all figures: of each radius, each press and each slide, and the bounds."""
    radii = list(dict.fromkeys(one.radius for one in pressed))
    table = [
        {
            "radius_edges": radius,
            **{kind: _figures([one for one in pressed if (one.radius, one.kind) == (radius, kind)]) for kind in KINDS},
        }
        for radius in radii
    ]
    fine, fair = ([one for one in pressed if low <= one.radius < high] for low, high in ((FINE, np.inf), (FAIR, FINE)))
    ripples = [one.ripple for one in slid if one.radius >= FINE]
    bounds = [
        Bound(f"force off finite elements, radii of {FINE:g} edge and more, worst", _worst(fine), FINE_WITHIN, "%"),
        Bound(f"force off finite elements, radii of {FAIR:g} to {FINE:g} edge, worst", _worst(fair), FAIR_WITHIN, "%"),
        Bound(
            "ripple of a sliding ball, radii of 1 edge and more, worst", max(ripples, default=None), MOST_RIPPLE, "%"
        ),
    ]
    return {
        "radii": table,
        "presses": [
            {
                "radius_edges": one.radius,
                "place": one.place,
                "kind": one.kind,
                "depth_radii": one.depths.tolist(),
                "force_n": one.ours.tolist(),
                "reference_n": _known(one.reference),
                "off_percent": _known(one.off),
            }
            for one in pressed
        ],
        "slides": [
            {
                "radius_edges": one.radius,
                "place": one.place,
                "friction": one.friction,
                "force_n": one.force,
                "ripple_percent": one.ripple,
            }
            for one in slid
        ],
        "bounds": [one.as_json() for one in bounds],
    }


def _known(values: Floats) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _offs(pressed: Sequence[Pressed]) -> Floats:
    """Return all differences, (k,) %, where finite elements settled."""
    every = np.concatenate([one.off for one in pressed]) if pressed else np.zeros(0)
    return np.asarray(every[np.isfinite(every)])


def _worst(pressed: Sequence[Pressed]) -> float | None:
    return float(np.abs(_offs(pressed)).max(initial=0.0)) if len(_offs(pressed)) else None


def _figures(pressed: Sequence[Pressed]) -> dict[str, Any]:
    """Return the difference that is largest, with its sign, and the median, %; how many there are, and aren't."""
    offs, tried = _offs(pressed), sum(len(one.depths) for one in pressed)
    if not len(offs):
        return {"worst_percent": None, "median_percent": None, "compared": 0, "unsettled": tried}
    return {
        "worst_percent": float(offs[np.abs(offs).argmax()]),
        "median_percent": float(np.median(offs)),
        "compared": len(offs),
        "unsettled": tried - len(offs),
    }


def text(found: dict[str, Any]) -> str:
    """Return the figures as tables."""
    edge = found["edge_m"]
    table = [["radius, edges", "mm", *(f"{kind}: {what}" for kind in KINDS for what in ("worst", "median"))]]
    unsettled = 0
    for row in found["radii"]:
        cells = [f"{row['radius_edges']:g}", f"{1e3 * edge * row['radius_edges']:.1f}"]
        for kind in KINDS:
            cells += [_signed(row[kind][what]) for what in ("worst_percent", "median_percent")]
            unsettled += row[kind]["unsettled"]
        table.append(cells)
    slid = [["radius, edges", "friction", "force N", "ripple: worst", "median"]]
    for radius, friction in dict.fromkeys((one["radius_edges"], one["friction"]) for one in found["slides"]):
        own = [one for one in found["slides"] if (one["radius_edges"], one["friction"]) == (radius, friction)]
        ripples = [one["ripple_percent"] for one in own]
        force = float(np.median([one["force_n"] for one in own]))
        slid.append(
            [f"{radius:g}", f"{friction:g}", f"{force:.3f}", f"{max(ripples):.1f} %", f"{np.median(ripples):.1f} %"]
        )
    deep = ", ".join(f"{depth:g}" for depth in DEPTHS)
    lines = [
        f"organ '{found['organ']}', mean edge {1e3 * edge:.2f} mm: balls that don't slip, {deep} radii deep at"
        f" {found['places']} flat places, off finite elements",
        "",
        *aligned(table),
        *([f"finite elements found no rest {unsettled} times; these are left out"] if unsettled else []),
        "",
        f"balls that slide {WAY:g} edges, {SLID_DEPTH:g} radii deep: half the force's range about a parabola",
        "",
        *aligned(slid),
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.1f} %"
