"""From a file or arrays to an organ, in one call: an image with a seed, a mask or a closed surface."""

from __future__ import annotations

import hashlib
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypedDict, TypeGuard, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.arguments import finite
from tissue_sim.array_types import Array, Longs
from tissue_sim.errors import UserError
from tissue_sim.organ.build_record import Progress
from tissue_sim.organ.inclusions import Inclusion, check_stiffness
from tissue_sim.organ.pipeline import organ_from_image, organ_from_mask, organ_from_mesh
from tissue_sim.organ.refinement import Refinement
from tissue_sim.organ.request import Request
from tissue_sim.organ.segmenting.anatomy import ANY_NAME
from tissue_sim.organ.segmenting.parameters import SegmentationParameters

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume
    from tissue_sim.organ.meshes.mesh_input import SurfaceMesh
    from tissue_sim.organ.organ import Organ

EXTRA = "install the extra: pip install 'tissue_sim[image]'"
_NUMBERED = re.compile(r"([^:]*:)?[\d.]+")  # 2 or 2.0, also in a layer: not a name
_PACKAGE = str(Path(__file__).resolve().parents[1])


class _Shared(TypedDict, total=False):
    """Options of a source among those of `build` that have no parameter of their own."""

    length: float | None
    keep_points: bool
    inclusions: Mapping[str, float]
    part: int | str | None
    merge_parts: bool
    series: str | None
    seed_voxel: ArrayLike | None
    segmentation: Mapping[str, float]


class BuildOptions(_Shared, total=False):
    """What `build` takes beside its source: the names are those of `tissue_sim build`.

    Of the organ: name; points of its surface; atoms, medial ones; branches, `auto` or `none`; interior atoms; organ,
    what it is, so that leaks are noticed; accept what can't be that organ; fixed nodes, `z<0.1` or indices (k,);
    youngs_modulus Pa; poisson_ratio; density kg/m^3; refinement, where edges are shorter. Of a surface: length m of its
    longest side, instead of a unit; keep_points. Of a mask: inclusions, how many times as stiff each further label is.
    Of both: part, merge_parts. Of an image: series of a DICOM folder; seed_voxel (3,); segmentation, fields of
    SegmentationParameters. progress: where the stages report.
    """

    name: str
    points: int
    atoms: int | None
    branches: str
    interior: int
    organ: str | None
    accept: bool
    fixed: str | Longs
    youngs_modulus: float
    poisson_ratio: float
    density: float
    refinement: Refinement
    progress: Progress


class SourceOptions(_Shared, total=False):
    """All options that determine how a source is read; see `build` and `BuildOptions`."""

    seed: ArrayLike
    label: int | str | None
    unit: str | None
    spacing: ArrayLike


class Mesh(Protocol):
    """A mesh as `trimesh.Trimesh` has it."""

    @property
    def vertices(self) -> ArrayLike:
        """Points (n, 3)."""

    @property
    def faces(self) -> ArrayLike:
        """Triangles (t, 3)."""


type File = str | os.PathLike[str]
type Source = File | Mesh | tuple[ArrayLike, ArrayLike] | ArrayLike

# Whose options these are; the rest are the organ's.
_OF_KIND = {
    "surface": {"unit", "length", "keep_points", "part", "merge_parts"},
    "mask": {"label", "spacing", "inclusions", "part", "merge_parts"},
    "image": {"seed", "seed_voxel", "spacing", "series", "segmentation"},
}
_OF_SOURCE = set().union(*_OF_KIND.values())
_A = {"surface": "a surface", "mask": "a mask", "image": "an image with a seed"}


def build(
    source: Source,
    *,
    seed: ArrayLike | None = None,
    label: int | str | None = None,
    unit: str | None = None,
    spacing: ArrayLike | None = None,
    **options: Unpack[BuildOptions],
) -> Organ:
    """Build an organ from an image, a mask or a closed surface.

    What can be repaired, or may be wrong, is warned of (`UserWarning`), or goes to `progress` where one is given.

    Parameters
    ----------
    source
        A file or DICOM folder; or a mesh, as `trimesh.Trimesh` or as positions (n, 3) and triangles (t, 3); or voxels
        (nx, ny, nz), along x, y and z, of a mask or in HU. A mesh file is a surface, an image with a seed is segmented,
        another one is a mask.
    seed
        (3,) mm, a point inside the organ: in the patient frame of the image, LPS.
    label
        Value or name of the organ in a mask that holds several.
    unit
        Length unit of a surface whose format doesn't say: m, cm, mm, um, in. Arrays are in m by default.
    spacing
        (3,) mm, of voxels that are given as an array.
    **options
        See `BuildOptions`.

    Returns
    -------
    Organ
        With springs; `calibrate` gives it cells that are as stiff as its tissue.

    Raises
    ------
    UserError
        In one line that names the source and the remedy, for what no organ can be made from.

    References
    ----------
    The stages are described on the page "Organs from images and meshes".
    """
    if unknown := sorted(options.keys() - BuildOptions.__annotations__.keys()):
        raise TypeError(f"build() got an unexpected keyword argument '{unknown[0]}'")
    try:
        return _built(source, {"seed": seed, "label": label, "unit": unit, "spacing": spacing, **options})
    except ModuleNotFoundError as error:
        raise UserError(f"building organs needs {error.name}; {EXTRA}") from None
    except UserError as error:  # of stages that the command line has, too
        raise UserError(re.sub(r"--([a-z]+(?:-[a-z]+)*)", lambda m: m[1].replace("-", "_"), str(error))) from None


def _built(source: Source, given: Mapping[str, Any]) -> Organ:
    """Return the organ; given: options of the source, and fields of Request, by name."""
    kind = _kind_of(source, given["seed"] is not None or given.get("seed_voxel") is not None)
    own = cast(SourceOptions, {name: given[name] for name in _OF_SOURCE & given.keys() if given[name] is not None})
    if foreign := sorted(own.keys() - _OF_KIND[kind]):
        raise UserError(f"{foreign[0]} does not belong to {_A[kind]}, which {_described(source)} is taken for")
    of_organ = {name: value for name, value in given.items() if name not in _OF_SOURCE}
    progress = of_organ.pop("progress", None) or Progress(_warn)
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    provenance = {"source": "arrays"} if path is None else {"source": path.name, "source_sha256": digest_of(path)}
    named = (of_organ.get("organ"), given.get("label"), given.get("part"))
    of_organ.setdefault("name", name_of(*named, stem_of(path) if path is not None else "organ"))
    request = Request(interior_atoms=of_organ.pop("interior", 0), provenance=provenance, **of_organ)
    return make(kind, source, request, own, progress)


def make(kind: str, source: Source, request: Request, given: SourceOptions, progress: Progress) -> Organ:
    """Read a source of a kind (surface, mask or image) and build the organ that is asked for.

    Parameters
    ----------
    kind
        What the source is.
    source
        See `build`.
    request
        What the organ is made with.
    given
        Options of the source, by name; see `build`.
    progress
        Where the stages report.

    Raises
    ------
    UserError
        As the stages do.
    """
    if kind == "surface":
        with progress.stage("read"):
            mesh = _surface(source, request.name, given)
        return organ_from_mesh(mesh, request, given.get("keep_points", False), progress=progress)
    if kind == "mask":
        from tissue_sim.organ.imaging.mask_parts import one_part

        wanted = dict(given.get("inclusions", {}))
        for stiffness in wanted.values():
            check_stiffness(stiffness)
        with progress.stage("read"):
            mask, *parts = _masks(source, request.name, given, list(wanted))
            part = cast(int | None, given.get("part"))  # only a surface's parts have names
            mask = one_part(mask, part, merge=given.get("merge_parts", False))
            request = replace(request, inclusions=_surrounded(parts, wanted, progress))
        for note in mask.notes:
            progress.say(note)
        return organ_from_mask(mask, request, progress=progress)
    with progress.stage("read"):
        image = _image(source, request.name, given)
    voxel = given.get("seed_voxel")
    seed = finite(given["seed"], 3, "seed") if voxel is None else image.to_points(finite(voxel, 3, "seed_voxel"))
    parameters = SegmentationParameters(**given.get("segmentation", {}))
    return organ_from_image(image, seed, request, parameters, progress=progress)


# sources -------------------------------------------------------------------------------------------


def _kind_of(source: Source, is_seeded: bool) -> str:
    """Return what a source is: surface, mask or image. Raises UserError for anything else."""
    if isinstance(source, str | os.PathLike):
        from tissue_sim.organ.meshes.mesh_formats import FORMATS

        is_surface = Path(source).suffix.lower() in FORMATS
    else:
        is_surface = _is_mesh(source) or (isinstance(source, tuple | list) and len(source) == 2)
        if not is_surface and np.ndim(cast(ArrayLike, source)) != 3:
            raise UserError(
                f"nothing can be built from {_described(source)}; give a file, a mesh, positions and triangles,"
                " or voxels (nx, ny, nz)"
            )
    return "surface" if is_surface else "image" if is_seeded else "mask"


def _is_mesh(source: Source) -> TypeGuard[Mesh]:
    return hasattr(source, "faces")


def _described(source: Source) -> str:
    if isinstance(source, str | os.PathLike):
        return str(source)
    shape = np.shape(source) if isinstance(source, np.ndarray) else ()
    return f"an array of shape {shape}" if shape else f"a {type(source).__name__}"


def _surface(source: Source, name: str, given: SourceOptions) -> SurfaceMesh:
    from tissue_sim.organ.meshes import mesh_input

    unit, longest, part = given.get("unit"), given.get("length"), given.get("part")
    merge = given.get("merge_parts", False)
    if isinstance(source, str | os.PathLike):
        file = source if isinstance(source, str) else Path(source)
        return mesh_input.read_mesh(file, unit, longest=longest, part=part, merge_parts=merge)
    pair = (source.vertices, source.faces) if _is_mesh(source) else cast(tuple[ArrayLike, ArrayLike], source)
    positions, triangles = pair
    piece = mesh_input.piece_of(np.asarray(positions), np.asarray(triangles), name)
    unit = unit or ("m" if longest is None else None)
    return mesh_input.mesh_of(piece, unit, longest=longest, part=part, merge_parts=merge)


def _masks(source: Source, name: str, given: SourceOptions, parts: Sequence[str]) -> list[Volume]:
    label = given.get("label")
    if isinstance(source, str | os.PathLike):
        from tissue_sim.organ.imaging.masks import read_masks

        return read_masks(source if isinstance(source, str) else Path(source), label, parts)
    voxels = np.asarray(source)
    values = np.unique(voxels[voxels != 0])
    if label is None and len(values) > 1:
        raise UserError(f"the mask holds {len(values)} values other than 0; choose one with label")
    inside = voxels != 0 if label is None else voxels == label
    covered = [voxels == float(part) for part in parts]
    inside = np.logical_or.reduce([inside, *covered])
    return [_volume(one, name, given) for one in (inside, *covered)]


def _image(source: Source, name: str, given: SourceOptions) -> Volume:
    if isinstance(source, str | os.PathLike):
        from tissue_sim.organ.imaging.image_file import read_image

        return read_image(source if isinstance(source, str) else Path(source), given.get("series"))
    return _volume(np.asarray(source, dtype=np.float32), name, given)


def _volume(voxels: Array, name: str, given: SourceOptions) -> Volume:
    """Return voxels (nx, ny, nz) as an image; the first one's centre is the origin."""
    from tissue_sim.organ.imaging.image import Volume

    if "spacing" not in given:
        raise UserError("voxels need a spacing: the distance, mm, of their centres along x, y and z")
    steps = finite(given["spacing"], 3, "spacing")
    if np.any(steps <= 0.0):
        raise UserError(f"spacing is {steps.tolist()}; expected: three numbers greater than 0, mm")
    return Volume(np.ascontiguousarray(voxels.transpose(2, 1, 0)), steps, np.zeros(3), np.eye(3), name)


def _surrounded(parts: Sequence[Volume], wanted: Mapping[str, float], progress: Progress) -> tuple[Inclusion, ...]:
    """Return inclusions around what each label covers, in the order of their masks."""
    if not wanted:
        return ()
    from tissue_sim.organ.surfaces.inclusion_surface import surround

    found: list[Inclusion] = []
    for mask, (label, stiffness) in zip(parts, wanted.items(), strict=True):
        inclusions, specks = surround(replace(mask, name=f"label {label}"), stiffness)
        found += inclusions
        if specks:
            progress.say(f"omitted {specks} specks of label {label}")
    return tuple(found)


# what is said of a source -----------------------------------------------------------------------------


def name_of(organ: str | None, label: int | str | None, part: int | str | None, otherwise: str) -> str:
    """Return an organ's name where none is given: what it is said to be, or the name of its label or part.

    Parameters
    ----------
    organ
        Kind of organ; None or `any`: unknown.
    label
        Number or name of a mask's label.
    part
        Number or name of a part.
    otherwise
        The name where none of these is one.
    """
    for word in (organ if organ != ANY_NAME else None, label, part):
        text = str(word or "").strip()
        if text and not _NUMBERED.fullmatch(text):
            return text
    return otherwise


def stem_of(path: Path) -> str:
    """Return the name of a file or folder, without its endings."""
    return path.name.removesuffix(".gz").rsplit(".", 1)[0] if not path.is_dir() else path.resolve().name


def digest_of(source: Path) -> str:
    """Return the SHA-256 (hex) of a file, or of a folder's file names and contents in order; empty if there is none."""
    if source.is_file():
        with source.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    if not source.is_dir():
        return ""
    whole = hashlib.sha256()
    for path in sorted(path for path in source.iterdir() if path.is_file()):
        whole.update(f"{path.name} {digest_of(path)}\n".encode())
    return whole.hexdigest()


def _warn(line: str) -> None:
    """Warn of what the stages found wrong or repaired, in the caller's file; the rest is reported to `progress` only.

    STL has no shared points, so that it says nothing about a file that some coincide.
    """
    if line.startswith(("warning: ", "repaired: ", "left out ")) and not line.startswith("repaired: merged "):
        warnings.warn(line.removeprefix("warning: "), stacklevel=2, skip_file_prefixes=(_PACKAGE,))
