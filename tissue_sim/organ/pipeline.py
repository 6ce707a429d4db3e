"""Making of an organ from a CT, a mask or a mesh: the stages in their order."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.fixed_nodes import select_fixed
from tissue_sim.organ.inclusions import Inclusion
from tissue_sim.organ.length_units import ORGAN_SIZE, is_organ
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.refinement import wanted_edges
from tissue_sim.organ.request import MOST_ATOMS, SPARSE, Request
from tissue_sim.organ.segmenting.parameters import SegmentationParameters
from tissue_sim.organ.tool_resolution import MOST_POINTS
from tissue_sim.organ.winding import inside

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume
    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh
    from tissue_sim.organ.organ import Organ
    from tissue_sim.organ.surfaces.surface import Wall

_NOTED, _WRONG = 0.05, 0.4  # relative error of the built volume
_REFINED = 0.9  # of the even surface's edges: shorter ones are refined
_LARGEST_IMAGE = 3.0  # m, longest side: a whole body
_PACKAGES = ("numpy", "scipy", "numba", "SimpleITK", "scikit-image", "trimesh")


def organ_from_image(
    ct: Volume,
    seed: Floats,
    request: Request,
    parameters: SegmentationParameters | None = None,
    progress: Progress | None = None,
) -> Organ:
    """Segment the organ around a seed point and build it.

    Parameters
    ----------
    ct : Volume
        The image.
    seed : Floats, shape (3,), mm
        Point in the organ, in LPS.
    request : Request
        What the organ is to be made with.
    parameters : SegmentationParameters | None, optional
        Parameters of the segmentation; None for the usual ones.
    progress : Progress | None, optional
        Receives the lines, the progress and the results of the stages.

    Raises
    ------
    UserError
        As the stages do.
    """
    from tissue_sim.organ.segmenting.segmentation import segment

    progress = progress or Progress()
    parameters = parameters or SegmentationParameters()
    ct = ct.upright()
    _check_image_size(ct)
    for note in ct.notes:
        progress.say(note)
    with progress.stage("segment"):
        found = segment(
            ct,
            seed,
            parameters,
            request.organ,
            request.accept,
            progress=lambda _part, done: progress.at("segment", done),
        )
    progress.say(
        f"segmented {found.volume:.1f} mL at {found.mean:.0f} HU, eroded {found.erosion:.1f} mm until separate"
        f" {progress.took('segment')}"
    )
    if request.organ is None:
        progress.say("checked against the bounds of any organ; --organ kidney, liver, ... detects smaller leaks")
    for line in found.warnings:
        progress.say(f"warning: {line}")
    record = progress.record
    record.ct, record.seed, record.segmentation = ct, seed, found
    provenance = {
        "seed_mm": [round(float(v), 3) for v in seed],
        "segmentation": found.figures(),
        "segmentation_parameters": asdict(parameters) | {"organ": request.organ or "any", "accept": request.accept},
    }
    return organ_from_mask(found.mask, _with(request, provenance), progress=progress)


def organ_from_mask(mask: Volume, request: Request, progress: Progress | None = None) -> Organ:
    """Build an organ from a mask: wall, balloon, skeleton, springs.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.
    request : Request
        What the organ is to be made with.
    progress : Progress | None, optional
        Receives the lines, the progress and the results of the stages.

    Raises
    ------
    UserError
        As the stages do, for a mask whose size is not an organ's, and where the organ's volume differs by more than two
        fifths from the mask's.
    """
    _check_mask_size(mask)
    volume = float(np.count_nonzero(mask.array)) * mask.voxel_volume
    return _inflated(mask, request, progress or Progress(), volume)


def _inflated(mask: Volume, request: Request, progress: Progress, volume: float) -> Organ:
    """Return an organ from a mask; volume: mL of what was read."""
    from tissue_sim.organ.surfaces.balloon import inflate
    from tissue_sim.organ.surfaces.surface import wall_of_surface

    wall = _wall(mask.upright(), progress)
    with progress.stage("balloon"):
        balloon = inflate(wall, request.points, progress=lambda done: progress.at("balloon", done))
        positions, triangles = balloon.positions, balloon.triangles
        off = wall_distance(wall, positions, triangles)
    progress.say(
        f"balloon of {len(positions)} points, {len(triangles)} triangles, mean distance from the wall {off:.2f} mm"
        f" {progress.took('balloon')}"
    )
    if not balloon.expanded:
        progress.say("the balloon intersected itself in a fold; the wall's own surface was decimated instead")
    for line in balloon.warnings:
        progress.say(f"warning: {line}")
    if balloon.missed > max(1.5 * wall.spacing, 0.5 * balloon.edge):
        progress.say(
            f"warning: the balloon did not reach folds of the wall up to {balloon.missed:.0f} mm deep; use more"
            " --points"
        )
    if request.refinement:
        positions, triangles = _refined(wall, positions, triangles, request, progress)
        balloon = replace(balloon, positions=positions, triangles=triangles)
    progress.record.balloon = balloon
    figures = {
        "wall_distance_mm": round(off, 4),
        "wall_missed_mm": round(balloon.missed, 3),
        "expanded": balloon.expanded,
        "grid_mm": wall.spacing,
        "points": request.points,
    }
    with progress.stage("skeleton"):
        solid = wall_of_surface(positions, triangles, wall)
    request = _compared(volume, wall.to_patient(positions), wall.outward(triangles), _with(request, figures), progress)
    return _assemble(solid, wall.to_patient(positions), wall.outward(triangles), request, progress)


def _refined(
    wall: Wall, positions: Floats, triangles: Ints, request: Request, progress: Progress
) -> tuple[Floats, Ints]:
    """Return the balloon surface, (n, 3) mm on the wall's grid, with more points where the request refines it."""
    from tissue_sim.organ.surfaces.fitting import mean_edge
    from tissue_sim.organ.surfaces.grading import graded

    placed = wall.to_patient(positions)
    wanted = wanted_edges(request.refinement, placed, wall.outward(triangles), select_fixed(request.fixed, placed))
    with progress.stage("balloon"):
        found = graded(positions, triangles, wall, lambda points: 1e3 * wanted(wall.to_patient(points)), MOST_POINTS)
    length = 1e3 * wanted(wall.to_patient(found[0]))
    finer = length < _REFINED * mean_edge(positions, triangles)
    progress.say(
        f"refined to {len(found[0])} points: edges from {length.min():.1f} mm on, at {np.count_nonzero(finer)} points"
        f" shorter than the {mean_edge(positions, triangles):.1f} mm elsewhere"
    )
    return found


def organ_from_mesh(
    surface: SurfaceMesh,
    request: Request,
    keep_points: bool = False,
    progress: Progress | None = None,
) -> Organ:
    """Build an organ from a closed surface.

    Parameters
    ----------
    surface : SurfaceMesh
        The surface.
    request : Request
        What the organ is to be made with.
    keep_points : bool, optional
        Whether the surface's points and their order are kept.
    progress : Progress | None, optional
        Receives the lines, the progress and the results of the stages.

    Raises
    ------
    UserError
        As the stages do.
    """
    from tissue_sim.organ.meshes.mesh_input import voxelize
    from tissue_sim.organ.surface_checks import signed_volume

    progress = progress or Progress()
    for line in surface.repairs:
        progress.say(f"repaired: {line}")
    for line in surface.notes:
        progress.say(line)
    progress.record.frame, progress.record.repairs = "mesh", tuple(surface.repairs)
    with progress.stage("wall"):
        mask = voxelize(surface, request.name)
    request = _with(
        request, {"repairs": list(surface.repairs), "notes": list(surface.notes), "keep_points": keep_points}
    )
    volume = 1e6 * signed_volume(surface.positions, surface.triangles)
    if not keep_points:
        return _inflated(mask, request, progress, volume)
    request = _compared(volume, surface.positions, surface.triangles, request, progress)
    return _assemble(_wall(mask, progress), surface.positions, surface.triangles, request, progress)


def _check_mask_size(mask: Volume) -> None:
    """Refuse a mask whose size is not an organ's: its header has a wrong spacing."""
    held = [np.flatnonzero(mask.array.any(axis=tuple({0, 1, 2} - {axis}))) for axis in (2, 1, 0)]
    if not all(len(index) for index in held):
        return  # the wall reports an empty mask
    size = 1e-3 * max(float(n[-1] - n[0] + 1) * step for n, step in zip(held, mask.spacing, strict=True))
    if not is_organ(size):
        raise UserError(
            f"mask {mask.name} is {size:.3g} m long, but an organ is 5 mm to 1 m; its voxels are {_voxels(mask)}:"
            " correct that in its header"
        )


def _check_image_size(image: Volume) -> None:
    size = 1e-3 * float((image.spacing * image.size).max())
    if not ORGAN_SIZE[0] <= size <= _LARGEST_IMAGE:
        raise UserError(
            f"image {image.name} is {size:.3g} m long, but a CT is 5 mm to {_LARGEST_IMAGE:g} m; its voxels are"
            f" {_voxels(image)}: correct that in its header"
        )


def _voxels(image: Volume) -> str:
    return " x ".join(f"{step:.4g}" for step in image.spacing) + " mm"


def _compared(volume: float, positions: Floats, triangles: Ints, request: Request, progress: Progress) -> Request:
    """Return the request with the volumes read and built, mL, in its provenance, and report both.

    Raises UserError where they differ by more than two fifths, and that isn't accepted.
    """
    from tissue_sim.organ.surface_checks import signed_volume

    built = 1e6 * signed_volume(positions, triangles)
    off = built / volume - 1.0
    volumes = f"{volume:.1f} mL read, {built:.1f} mL built ({100.0 * off:+.1f} %)"
    if abs(off) > _WRONG and not request.accept:
        raise UserError(
            f"{request.name} differs from its input: {volumes}; resample a thin mask more finely, close its gaps, or"
            " accept it with --accept"
        )
    progress.say(
        f"warning: {volumes}; a finer mask or more --points reduces the difference" if abs(off) > _NOTED else volumes
    )
    return _with(request, {"volume_read_ml": round(volume, 3), "volume_built_ml": round(built, 3)})


def _wall(mask: Volume, progress: Progress) -> Wall:
    from tissue_sim.organ.surfaces.surface import make_wall

    with progress.stage("wall"):
        wall = make_wall(mask)
    progress.record.mask, progress.record.wall = mask, wall
    if wall.fragments:
        progress.say(f"omitted {wall.fragments} separate fragment{'s' if wall.fragments > 1 else ''} of the mask")
    if wall.filled or wall.cut:
        progress.say(f"closed cavities and handles of the mask: {wall.filled:.2f} mL filled, {wall.cut:.2f} mL cut")
    return wall


def _assemble(wall: Wall, positions: Floats, triangles: Ints, request: Request, progress: Progress) -> Organ:
    from tissue_sim.organ.skeletons.skeleton import extract
    from tissue_sim.organ.topology import assemble_organ

    with progress.stage("skeleton"):
        skeleton = extract(wall, request.atoms or MOST_ATOMS, request.branches)
        if request.atoms is None and skeleton.branches <= 1:
            edge = 1e3 * float(np.linalg.norm(positions[triangles] - positions[triangles[:, [1, 2, 0]]], axis=2).mean())
            room = 1 + int(skeleton.length / (SPARSE * edge))
            if room < MOST_ATOMS:
                skeleton = extract(wall, room, request.branches)
    atoms = len(skeleton.radius)
    branches = f" in {skeleton.branches} branches" if skeleton.branches > 1 else ""
    low, high = skeleton.radius.min(), skeleton.radius.max()
    progress.say(
        f"skeleton of {atoms} atoms{branches} along {skeleton.length:.1f} mm, radius {low:.1f} to"
        f" {high:.1f} mm {progress.took('skeleton')}"
    )
    figures = {
        "atoms": atoms,
        "branches": request.branches,
        "interior_atoms": request.interior_atoms,
        "skeleton_length_mm": round(skeleton.length, 3),
        "fixed": Path(request.fixed).name if isinstance(request.fixed, str) else f"{len(request.fixed)} nodes",
        "packages": _versions(),
    }
    for inclusion in request.inclusions:
        _place(inclusion, positions, triangles, progress)
    with progress.stage("springs"):
        organ = assemble_organ(
            name=request.name,
            surface_positions=positions,
            surface_triangles=triangles,
            atom_positions=wall.to_patient(skeleton.positions),
            atom_radius=skeleton.radius * 1e-3,
            atom_parent=skeleton.parent,
            interior_atoms=request.interior_atoms,
            fixed=select_fixed(request.fixed, positions),
            youngs_modulus=request.youngs_modulus,
            poisson_ratio=request.poisson_ratio,
            density=request.density,
            inclusions=request.inclusions,
            provenance={**request.provenance, **figures},
        )
    record = progress.record
    record.skeleton, record.organ, record.request = skeleton, organ, request
    return organ


def _place(inclusion: Inclusion, positions: Floats, triangles: Ints, progress: Progress) -> None:
    """Report where an inclusion lies within the organ's surface; raises UserError where it is outside."""
    from tissue_sim.organ.surface_checks import signed_volume
    from tissue_sim.organ.surfaces.surface_distance import distance_to_surface

    within = inside(inclusion.positions, positions, triangles)
    volume = 1e6 * signed_volume(inclusion.positions, inclusion.triangles)
    if not within.any():
        raise UserError(f"an inclusion of {volume:.2f} mL is outside the organ; choose another label")
    depth = 1e3 * float(distance_to_surface(inclusion.positions, positions, triangles)[within].min())
    out = "" if within.all() else ", partly outside it: the part outside is omitted"
    progress.say(
        f"inclusion of {volume:.2f} mL, {inclusion.stiffness:g} times as stiff, {depth:.1f} mm under the surface{out}"
    )


def wall_distance(wall: Wall, positions: Floats, triangles: Ints) -> float:
    """Return the mean distance, mm, of the triangles from the wall: at corners, edge centres and centroids, by area."""
    corner = positions[triangles]
    area = triangle_area(positions, triangles)
    weights = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=float)
    weights /= weights.sum(axis=1, keepdims=True)
    probes = np.einsum("wk,tkd->twd", weights, corner)
    distance = np.abs(wall.sample(probes.reshape(-1, 3))).reshape(len(triangles), -1).mean(axis=1)
    return float(np.average(distance, weights=area))


def _with(request: Request, provenance: JsonObject) -> Request:
    return replace(request, provenance={**request.provenance, **provenance})


def _versions() -> dict[str, str]:
    from importlib.metadata import PackageNotFoundError, version

    found = {}
    for package in ("tissue_sim", *_PACKAGES):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
