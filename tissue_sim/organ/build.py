"""`tissue_sim build`: from a CT, a segmentation or a mesh to an organ file."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.errors import UserError

if TYPE_CHECKING:
    from tissue_sim.organ.image import Volume
    from tissue_sim.organ.mesh_input import SurfaceMesh
    from tissue_sim.organ.organ import Organ
    from tissue_sim.organ.segmentation import SegmentationParameters
    from tissue_sim.organ.surface import Wall

Floats = NDArray[np.float64]
Tell = Callable[[str], None]

_FIXED = re.compile(r"([xyz])\s*([<>])\s*([0-9]*\.?[0-9]+)")
_PACKAGES = ("numpy", "scipy", "SimpleITK", "scikit-image", "trimesh")


@dataclass(frozen=True)
class Request:
    """What an organ is made with, whatever it is made from."""

    name: str
    points: int = 994
    atoms: int = 48
    fixed: str = "z<0.1"
    youngs_modulus: float = 10_000.0  # Pa
    poisson_ratio: float = 0.45
    density: float = 1060.0  # kg/m^3
    provenance: dict[str, Any] = field(default_factory=dict)


def _quiet(_line: str) -> None:
    return None


def organ_from_image(
    ct: Volume, seed: Floats, request: Request, parameters: SegmentationParameters | None = None, tell: Tell = _quiet
) -> Organ:
    """Segment the organ around `seed`, (3,) mm LPS, and build it. Raises UserError as the stages do."""
    from tissue_sim.organ.segmentation import segment

    started = time.perf_counter()
    found = segment(ct, seed, parameters)
    tell(
        f"segmented {found.volume:.1f} mL at {found.mean:.0f} HU, eroded {found.erosion:g} mm until separate"
        f" ({time.perf_counter() - started:.1f} s)"
    )
    if found.at_edge:
        tell("warning: the organ reaches the image's border, so a part of it is missing")
    provenance = {"seed_mm": [round(float(v), 3) for v in seed], "segmentation": found.figures()}
    return organ_from_mask(found.mask, _with(request, provenance), tell)


def organ_from_mask(mask: Volume, request: Request, tell: Tell = _quiet) -> Organ:
    """Build an organ from a bool mask: wall, balloon, skeleton, springs. Raises UserError as the stages do."""
    from tissue_sim.organ.balloon import inflate
    from tissue_sim.organ.surface import wall_of_surface

    started = time.perf_counter()
    wall = _wall(mask, tell)
    balloon = inflate(wall, request.points)
    positions, triangles = balloon.positions, balloon.triangles
    off = wall_distance(wall, positions, triangles)
    tell(
        f"balloon of {len(positions)} points, {len(triangles)} triangles, {off:.2f} mm from the wall in the mean"
        f" ({time.perf_counter() - started:.1f} s)"
    )
    if balloon.missed > 2.0 * balloon.edge:
        tell(f"warning: the balloon left out folds of the wall, up to {balloon.missed:.0f} mm deep; use more --points")
    figures = {"wall_distance_mm": round(off, 4), "wall_missed_mm": round(balloon.missed, 3), "grid_mm": wall.spacing}
    solid = wall_of_surface(positions, triangles, wall)
    return _assemble(solid, wall.to_patient(positions), wall.outward(triangles), _with(request, figures), tell)


def organ_from_mesh(surface: SurfaceMesh, request: Request, keep_points: bool = False, tell: Tell = _quiet) -> Organ:
    """Build an organ from a closed surface; `keep_points` keeps its points and their order.

    Raises UserError as the stages do.
    """
    from tissue_sim.organ.mesh_input import voxelize

    for line in surface.repairs:
        tell(f"repaired: {line}")
    mask = voxelize(surface, request.name)
    request = _with(request, {"repairs": list(surface.repairs), "keep_points": keep_points})
    if not keep_points:
        return organ_from_mask(mask, request, tell)
    return _assemble(_wall(mask, tell), surface.positions, surface.triangles, request, tell)


def _wall(mask: Volume, tell: Tell) -> Wall:
    from tissue_sim.organ.surface import make_wall

    wall = make_wall(mask)
    if wall.fragments:
        tell(f"left out {wall.fragments} separate fragment{'s' if wall.fragments > 1 else ''} of the mask")
    if wall.filled:
        tell(f"closed handles of the mask with {wall.filled:.2f} mL")
    return wall


def _assemble(wall: Wall, positions: Floats, triangles: NDArray[np.int32], request: Request, tell: Tell) -> Organ:
    from tissue_sim.organ.skeleton import extract
    from tissue_sim.organ.topology import assemble_organ

    started = time.perf_counter()
    skeleton = extract(wall, request.atoms)
    tell(
        f"skeleton of {request.atoms} atoms along {skeleton.length:.1f} mm, radius {skeleton.radius.min():.1f} to"
        f" {skeleton.radius.max():.1f} mm ({time.perf_counter() - started:.1f} s)"
    )
    return assemble_organ(
        name=request.name,
        surface_positions=positions,
        surface_triangles=triangles,
        atom_positions=wall.to_patient(skeleton.positions),
        atom_radius=skeleton.radius * 1e-3,
        atom_parent=skeleton.parent,
        fixed=select_fixed(request.fixed, positions),
        youngs_modulus=request.youngs_modulus,
        poisson_ratio=request.poisson_ratio,
        density=request.density,
        provenance={**request.provenance, "fixed": Path(request.fixed).name, "packages": _versions()},
    )


def wall_distance(wall: Wall, positions: Floats, triangles: NDArray[np.int32]) -> float:
    """Mean distance, mm, of the triangles from the wall: at corners, middles of edges and centres, by area."""
    corner = positions[triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    weights = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=float)
    weights /= weights.sum(axis=1, keepdims=True)
    probes = np.einsum("wk,tkd->twd", weights, corner)
    distance = np.abs(wall.sample(probes.reshape(-1, 3))).reshape(len(triangles), -1).mean(axis=1)
    return float(np.average(distance, weights=area))


def select_fixed(choice: str, positions: Floats) -> NDArray[np.int32]:
    """Indices of the surface nodes that `choice` names: `none`, `z<0.1` or a .npy file of indices.

    `z<0.1` is the lowest tenth of the extent along z; axes x, y, z, < or >. Raises UserError otherwise.
    """
    text = choice.strip()
    if text.lower() == "none":
        return np.empty(0, dtype=np.int32)
    if text.endswith(".npy"):
        return _fixed_from_file(Path(text), len(positions))
    match = _FIXED.fullmatch(text)
    if match is None:
        raise UserError(f"--fixed '{choice}' is not understood; use 'z<0.1' (axis, < or >, share), a .npy file or none")
    axis, side, share = "xyz".index(match[1]), match[2], float(match[3])
    if not 0.0 <= share <= 1.0:
        raise UserError(f"--fixed '{choice}': the share of the extent must lie within 0..1")
    along = positions[:, axis]
    level = along.min() + share * np.ptp(along)
    chosen = np.flatnonzero(along <= level if side == "<" else along >= level)
    return chosen.astype(np.int32)


def _fixed_from_file(path: Path, count: int) -> NDArray[np.int32]:
    try:
        index = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"--fixed file {path} does not exist") from None
    except (OSError, ValueError, EOFError):
        raise UserError(f"--fixed file {path} is no .npy file of indices") from None
    if index.ndim != 1 or not np.issubdtype(index.dtype, np.integer):
        raise UserError(f"--fixed file {path} must hold a 1-D array of integers, has {index.dtype} {index.shape}")
    if len(index) and (index.min() < 0 or index.max() >= count):
        raise UserError(f"--fixed file {path} names nodes outside 0..{count - 1}")
    return np.unique(index).astype(np.int32)


def _with(request: Request, provenance: dict[str, Any]) -> Request:
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


# command line ----------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `tissue_sim build`."""
    parser.add_argument("image", nargs="?", metavar="IMAGE", help="CT: a NIfTI, NRRD or MHA file, or a DICOM folder")
    source = parser.add_argument_group("what the organ is made from (IMAGE with a seed, or one of --mask, --surface)")
    source.add_argument(
        "--seed",
        metavar="X,Y,Z",
        help="a point inside the organ: millimetres in the patient frame of the image, LPS (x to the patient's left,"
        " y to the back, z to the head), for every format; Slicer and ITK-SNAP show R,A,S: negate the first two",
    )
    source.add_argument(
        "--seed-voxel", metavar="I,J,K", help="the same as voxel indices, from 0, in the file's axis order"
    )
    source.add_argument("--series", metavar="UID", help="series to read when the DICOM folder holds several")
    source.add_argument("--mask", metavar="FILE", help="start from a segmentation (same formats) instead of a seed")
    source.add_argument("--label", type=int, metavar="N", help="value of the organ in --mask when it holds several")
    source.add_argument("--surface", metavar="FILE", help="start from a closed mesh (OBJ, STL, PLY, OFF, GLB)")
    source.add_argument("--keep-points", action="store_true", help="keep the points of --surface and their order")
    source.add_argument("--unit", choices=("mm", "m"), help="length unit of --surface where the format doesn't say")
    organ = parser.add_argument_group("the organ")
    organ.add_argument("--out", default="organ.npz", metavar="FILE", help="organ file to write (default: %(default)s)")
    organ.add_argument("--name", help="name of the organ (default: the input's file name)")
    organ.add_argument("--points", type=int, default=994, help="points of the balloon (default: %(default)s)")
    organ.add_argument("--atoms", type=int, default=48, help="medial atoms of the skeleton (default: %(default)s)")
    organ.add_argument(
        "--fixed",
        default="z<0.1",
        metavar="WHICH",
        help="surface nodes that are held: 'z<0.1' for the lowest tenth along z (axes x, y, z; < or >),"
        " a .npy file of indices, or none (default: %(default)s)",
    )
    organ.add_argument("--youngs-modulus", type=float, default=10_000.0, metavar="PA", help="Pa (default: %(default)g)")
    organ.add_argument("--poisson-ratio", type=float, default=0.45, metavar="NU", help="default: %(default)g")
    organ.add_argument("--density", type=float, default=1060.0, metavar="KG_M3", help="kg/m^3 (default: %(default)g)")
    stages = parser.add_argument_group("segmentation from a seed (defaults are worked out from the image)")
    stages.add_argument(
        "--smoothing",
        type=float,
        default=2.5,
        metavar="MM",
        help="standard deviation of the Gaussian before intensities are compared, mm (default: %(default)g)",
    )
    stages.add_argument(
        "--window",
        type=float,
        default=3.0,
        metavar="SD",
        help="half-width of the intensity window, in standard deviations of the organ (default: %(default)g)",
    )
    stages.add_argument(
        "--erosion", type=float, metavar="MM", help="erosion depth, mm (default: until the organ is separate)"
    )
    stages.add_argument(
        "--grid",
        type=float,
        metavar="MM",
        help="spacing of the working grid, mm (default: half the image's coarsest, within 1..1.5)",
    )


def run(args: argparse.Namespace) -> int:
    """Build the organ that the arguments describe, print what was done, return 0. Raises UserError."""
    started = time.perf_counter()
    source = _source(args)
    out = Path(args.out)
    if not out.parent.is_dir():
        raise UserError(f"folder {out.parent} for the organ file does not exist; make it first")
    _check_counts(args)
    name = args.name or _stem(Path(source))
    request = Request(
        name=name,
        points=args.points,
        atoms=args.atoms,
        fixed=args.fixed,
        youngs_modulus=args.youngs_modulus,
        poisson_ratio=args.poisson_ratio,
        density=args.density,
        provenance={"source": Path(source).name},
    )
    try:
        organ = _build(args, request)
    except ModuleNotFoundError as error:
        raise UserError(
            f"building organs needs {error.name}; install the extra: pip install 'tissue_sim[image]'"
        ) from None
    organ.save(out)
    n = organ.n_surface
    print(
        f"{out}: {name}, {organ.volume * 1e6:.1f} mL, {n} points, {len(organ.surface_triangles)} triangles,"
        f" {organ.n_atoms} atoms, {len(organ.fixed)} held, {time.perf_counter() - started:.1f} s"
    )
    return 0


def _check_counts(args: argparse.Namespace) -> None:
    """Refuse at once what would be refused after the segmentation."""
    from tissue_sim.organ.balloon import check_points
    from tissue_sim.organ.skeleton import check_atoms

    if not args.keep_points:
        check_points(args.points)
    check_atoms(args.atoms)
    if not args.fixed.strip().endswith(".npy"):
        select_fixed(args.fixed, np.zeros((1, 3)))


def _source(args: argparse.Namespace) -> str:
    """The one input that was named; refuses none, several, and options that don't belong to it."""
    inputs = (("IMAGE", args.image), ("--mask", args.mask), ("--surface", args.surface))
    given = [(what, path) for what, path in inputs if path]
    if not given:
        raise UserError("nothing to build from; name an IMAGE with --seed, a --mask or a --surface")
    if len(given) > 1:
        raise UserError(f"{' and '.join(what for what, _ in given)} were given; choose one")
    what, path = given[0]
    seeded = args.seed or args.seed_voxel
    if what == "IMAGE" and not seeded:
        raise UserError("an image needs a point inside the organ: --seed X,Y,Z or --seed-voxel I,J,K")
    if args.seed and args.seed_voxel:
        raise UserError("--seed and --seed-voxel were given; choose one")
    for option, value, owner in (
        ("--seed", seeded, "IMAGE"),
        ("--series", args.series, "IMAGE"),
        ("--label", args.label is not None, "--mask"),
        ("--unit", args.unit, "--surface"),
        ("--keep-points", args.keep_points, "--surface"),
    ):
        if value and owner != what:
            raise UserError(f"{option} belongs to {owner}, not to {what}")
    return str(path)


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").rsplit(".", 1)[0] if not path.is_dir() else path.resolve().name


def _build(args: argparse.Namespace, request: Request) -> Organ:
    from tqdm import tqdm

    if args.surface:
        from tissue_sim.organ.mesh_input import read_mesh

        return organ_from_mesh(read_mesh(args.surface, args.unit), request, args.keep_points, tqdm.write)
    from tissue_sim.organ.image import read_image, read_mask

    if args.mask:
        return organ_from_mask(read_mask(args.mask, args.label), request, tqdm.write)
    from tissue_sim.organ.segmentation import SegmentationParameters

    parameters = SegmentationParameters(
        smoothing=_positive("--smoothing", args.smoothing),
        window=_positive("--window", args.window),
        erosion=None if args.erosion is None else _positive("--erosion", args.erosion),
        grid=None if args.grid is None else _positive("--grid", args.grid),
    )
    given = parse_triple("--seed", args.seed) if args.seed else parse_triple("--seed-voxel", args.seed_voxel)
    ct = read_image(args.image, args.series)
    seed = given if args.seed else ct.to_points(given)
    return organ_from_image(ct, seed, request, parameters, tqdm.write)


def _positive(option: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0.0):
        raise UserError(f"{option} {value:g} must be greater than 0")
    return value


def parse_triple(option: str, text: str) -> Floats:
    """Three finite numbers, (3,), of a text like `1.5,-20,300`. Raises UserError naming the option."""
    try:
        values = np.array([float(part) for part in text.replace(" ", "").split(",")])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.all(np.isfinite(values)):
        raise UserError(f"{option} '{text}' is not three numbers; write them as 1.5,-20,300")
    return values
