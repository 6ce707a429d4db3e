"""The organ file: geometry, springs, tissue and provenance in one NPZ, opened without pickle."""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass, field, fields
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue_sim.array_types import Array, Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonMapping
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ_file import LAW, SCHEMA_VERSION, check_law, content_digest, read_fields
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surface_checks import check_surface, signed_volume

_FARTHEST = 1e3  # m, from the origin: farther out a double resolves the organ poorly, and squares overflow
# Range of every other number, in SI units: what lies outside is a mistake, and computing with it gives no number.
_LEAST, _MOST = 1e-12, 1e12
_POSITIVE = ("mass", "spring_rest_length", "atom_radius", "cell_mu", "inclusion_stiffness")


class SpringKind(IntEnum):
    """Kinds of axial springs by what they join; springs are stored in this order."""

    EDGE = 0  # two surface nodes of one triangle edge
    SPOKE = 1  # part of a spoke: a surface node and its nearest inner node, an interior atom and its medial atom
    VIRTUAL = 2  # a surface node and the next of its four nearest inner nodes; interior atoms and their neighbours
    SKELETON = 3  # two neighbouring medial atoms


def _floats(*shape: int | str, empty: tuple[int, ...] | None = None) -> Floats:
    return _array(np.float64, shape, empty)


def _ints(*shape: int | str, empty: tuple[int, ...] | None = None) -> Ints:
    return _array(np.int32, shape, empty)


def _array[T: np.generic](dtype: type[T], shape: tuple[int | str, ...], empty: tuple[int, ...] | None) -> NDArray[T]:
    """Return a field that holds an array; empty: its default shape, or None where the array is required."""
    metadata = {"dtype": dtype, "shape": shape}
    if empty is None:
        return field(metadata=metadata)
    return field(default_factory=lambda: np.zeros(empty, dtype=dtype), metadata=metadata)


@dataclass(frozen=True, eq=False, repr=False)
class Organ:
    """Organ ready to be simulated, in SI units; every array is read-only.

    Nodes are numbered surface first, then medial atoms, then interior atoms, then the virtual nodes of cut tissue:
    `n = n_surface + n_atoms + n_interior + n_virtual`. The inner nodes are the medial and interior atoms. The comments
    beside the fields give units and meaning.

    Raises
    ------
    UserError
        Where arrays don't fit together or hold non-finite values, and where the surface isn't one closed outward
        surface; the message names the field.
    """

    name: str
    surface_positions: Floats = _floats("n_surface", 3)  # m, at rest
    surface_triangles: Ints = _ints("n_triangles", 3)  # counter-clockwise seen from outside
    atom_positions: Floats = _floats("n_atoms", 3)  # m, at rest
    atom_radius: Floats = _floats("n_atoms")  # m, distance to the boundary
    atom_parent: Ints = _ints("n_atoms")  # neighbour towards the root, -1 at the root
    interior_positions: Floats = _floats("n_interior", 3)  # m, at rest: interior atoms
    interior_spoke: Ints = _ints("n_interior", 2)  # the medial atom and the surface node that its spoke joins
    fixed: Ints = _ints("n_fixed")  # surface nodes that are held
    mass: Floats = _floats("n")  # kg
    damping: Floats = _floats("n")  # kg/s, nodal
    return_stiffness: Floats = _floats("n")  # N/m, towards the rest position
    spring_nodes: Ints = _ints("n_springs", 2)
    spring_rest_length: Floats = _floats("n_springs")  # m
    spring_stiffness: Floats = _floats("n_springs")  # N/m
    spring_kind: Ints = _ints("n_springs")  # SpringKind
    angular_nodes: Ints = _ints("n_angular", 4)  # edge i, j and the corners k, l opposite to it
    angular_stiffness: Floats = _floats("n_angular")  # N/m, on edge length times angle
    youngs_modulus: float = 0.0  # Pa
    poisson_ratio: float = 0.0
    density: float = 0.0  # kg/m^3
    provenance: JsonMapping = field(default_factory=dict)
    # Of calibrated tissue: tetrahedra between the nodes, det(b - a, c - a, d - a) > 0. None where springs are all.
    cell_nodes: Ints = _ints("n_cells", 4, empty=(0, 4))
    cell_mu: Floats = _floats("n_cells", empty=(0,))  # Pa, shear modulus
    cell_lambda: Floats = _floats("n_cells", empty=(0,))  # Pa, Lame's first
    # Of tissue of another stiffness, such as a tumour: closed surfaces. None in most organs.
    inclusion_positions: Floats = _floats("n_inclusion_points", 3, empty=(0, 3))  # m, at rest
    inclusion_triangles: Ints = _ints("n_inclusion_triangles", 3, empty=(0, 3))  # outward
    inclusion_of: Ints = _ints("n_inclusion_triangles", empty=(0,))  # which inclusion each of them bounds
    inclusion_stiffness: Floats = _floats("n_inclusions", empty=(0,))  # times the tissue's moduli
    # Of cut tissue: the node that each virtual node copies, at the same rest position.
    virtual_of: Ints = _ints("n_virtual", empty=(0,))
    # Of tissue that stiffens with strain or relaxes; 0: neo-Hookean, elastic.
    stiffening: float = 0.0  # b of Demiray's law
    cell_stiffening: float = 1.0  # the cells' b over that of the tissue, of a calibration
    relaxation_fraction: float = 0.0  # of the first force that relaxes
    relaxation_time: float = 0.0  # s

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {}
        for item in fields(self):
            if "dtype" not in item.metadata:
                continue
            array = _frozen(item.name, getattr(self, item.name), item.metadata["dtype"])
            _check_shape(item.name, array, item.metadata["shape"], sizes)
            object.__setattr__(self, item.name, array)
        self._check_numbers()
        self._check_law()
        self._check(sizes)

    def __repr__(self) -> str:
        tissue = f"{len(self.cell_nodes)} cells" if len(self.cell_nodes) else f"{len(self.spring_nodes)} springs"
        return (
            f"<Organ '{self.name}': {1e6 * self.volume:.1f} mL, {self.n_surface} surface nodes,"
            f" {len(self.surface_triangles)} triangles, {self.n_atoms} medial and {self.n_interior} interior atoms,"
            f" {tissue}, {len(self.fixed)} nodes fixed{f', {self.n_virtual} virtual' if self.n_virtual else ''}>"
        )

    # sizes -------------------------------------------------------------------------------------
    @property
    def n_surface(self) -> int:
        """Number of surface nodes."""
        return len(self.surface_positions)

    @property
    def n_atoms(self) -> int:
        """Number of medial atoms."""
        return len(self.atom_positions)

    @property
    def n_nodes(self) -> int:
        """Number of all nodes: surface, medial atoms, interior atoms, virtual nodes."""
        return self.n_surface + self.n_atoms + self.n_interior + self.n_virtual

    @property
    def n_interior(self) -> int:
        """Number of interior atoms."""
        return len(self.interior_positions)

    @property
    def n_virtual(self) -> int:
        """Number of virtual nodes; 0 where nothing is cut."""
        return len(self.virtual_of)

    @property
    def n_uncut(self) -> int:
        """Number of nodes without the virtual ones."""
        return self.n_nodes - self.n_virtual

    @property
    def rest_positions(self) -> Floats:
        """Rest positions of all nodes, (n, 3) m: surface, medial atoms, interior, virtual."""
        own = np.concatenate([self.surface_positions, self.atom_positions, self.interior_positions])
        return np.concatenate([own, own[self.virtual_of]])

    @property
    def surface_normals(self) -> Floats:
        """Return the outward unit normals of the rest surface, (n_surface, 3)."""
        return surface_normals(self.surface_positions, self.surface_triangles)

    @property
    def schema_version(self) -> int:
        """Schema version of its file: the oldest that can hold it, so that older packages can read it."""
        if self._law():
            return SCHEMA_VERSION
        if self.n_virtual:
            return 6
        return 5 if len(self.inclusion_stiffness) else 4

    @property
    def volume(self) -> float:
        """Volume enclosed by the rest surface, m^3 (divergence theorem)."""
        return signed_volume(self.surface_positions, self.surface_triangles)

    @property
    def lame_moduli(self) -> tuple[float, float]:
        """Lame's moduli of the tissue, Pa: mu, the shear modulus, and lambda."""
        e, nu = self.youngs_modulus, self.poisson_ratio
        return e / (2.0 * (1.0 + nu)), e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    # checks ------------------------------------------------------------------------------------
    def _check(self, sizes: dict[str, int]) -> None:
        given = sizes["n_surface"] + sizes["n_atoms"] + sizes["n_interior"]
        n = given + sizes["n_virtual"]
        if sizes["n"] != n:
            raise UserError(f"organ '{self.name}': mass has {sizes['n']} entries for {n} nodes")
        limits = {
            "surface_triangles": sizes["n_surface"],
            "fixed": sizes["n_surface"],
            "spring_nodes": n,
            "angular_nodes": n,
            "cell_nodes": n,
            "inclusion_triangles": sizes["n_inclusion_points"],
            "inclusion_of": sizes["n_inclusions"],
            "virtual_of": given,
        }
        for key, limit in limits.items():
            array = getattr(self, key)
            if array.size and (array.min() < 0 or array.max() >= limit):
                raise UserError(f"organ '{self.name}': {key} names a node outside 0..{limit - 1}")
        spoke = self.interior_spoke
        if spoke.size and (spoke.min() < 0 or np.any(spoke.max(axis=0) >= [sizes["n_atoms"], sizes["n_surface"]])):
            raise UserError(f"organ '{self.name}': interior_spoke names an atom or surface node that doesn't exist")
        parent = self.atom_parent
        if parent.size and (parent.min() < -1 or np.any(parent >= np.arange(len(parent)))):
            raise UserError(f"organ '{self.name}': atom_parent must name an earlier atom, or -1 for the root")
        for key in ("damping", "return_stiffness", "spring_stiffness", "angular_stiffness", "cell_lambda"):
            if np.any(getattr(self, key) < 0.0):
                raise UserError(f"organ '{self.name}': {key} must not be negative")
        corner = self.rest_positions[self.cell_nodes]
        if np.any(np.linalg.det(corner[:, 1:] - corner[:, :1]) <= 0.0):
            raise UserError(f"organ '{self.name}': cell_nodes contains cells without volume or inverted cells")
        check_surface(self.surface_positions, self.surface_triangles, f"organ '{self.name}'")
        for number in range(sizes["n_inclusions"]):
            used, own = np.unique(self.inclusion_triangles[self.inclusion_of == number], return_inverse=True)
            name = f"inclusion {number} of organ '{self.name}'"
            check_surface(self.inclusion_positions[used], own.reshape(-1, 3).astype(np.int32), name)

    def _law(self) -> dict[str, float]:
        """Return what makes tissue stiffen or relax; nothing of neo-Hookean, elastic tissue."""
        return {name: float(getattr(self, name)) for name, usual in LAW.items() if getattr(self, name) != usual[0]}

    def _check_law(self) -> None:
        """Refuse a law out of range."""
        check_law(f"organ '{self.name}': ", **self._law())

    def _check_numbers(self) -> None:
        """Refuse numbers out of range, with which arithmetic would overflow."""
        for item in fields(self):
            if item.metadata.get("dtype") is not np.float64:
                continue
            size = np.abs(getattr(self, item.name))
            if item.name in _POSITIVE and np.any(getattr(self, item.name) <= 0.0):
                raise UserError(f"organ '{self.name}': {item.name} must be greater than 0 everywhere")
            most = _FARTHEST if item.name.endswith("_positions") else _MOST
            least = _LEAST if item.name in _POSITIVE else 0.0
            if size.size and (size.max() > most or size.min() < least):
                odd = size.max() if size.max() > most else size.min()
                raise UserError(f"organ '{self.name}': {item.name} holds {odd:.3g}, outside {least:g}..{most:g}")

    # files -------------------------------------------------------------------------------------
    @classmethod
    def shipped(cls, name: str = "kidney") -> Organ:
        """Return an organ that ships with the package: kidney, kidney_as_built (of springs) or kidney_tumour.

        Raises
        ------
        UserError
            When none of that name is installed.
        """
        return cls.load(shipped_organ(name))

    def to_bytes(self) -> bytes:
        """Return the organ file: a compressed NPZ that holds the schema version and the SHA-256 of its content.

        The same organ gives the same bytes.
        """
        arrays = self._arrays()
        header = {
            "format": "tissue_sim organ",
            "schema_version": self.schema_version,
            "name": self.name,
            "units": "SI: m, kg, s, N, Pa",
            "youngs_modulus": float(self.youngs_modulus),
            "poisson_ratio": float(self.poisson_ratio),
            "density": float(self.density),
            **self._law(),
            "provenance": dict(self.provenance),
        }
        text, stream = json.dumps(header, sort_keys=True), io.BytesIO()
        digest = content_digest(text, arrays)
        headed = {"header": np.array(text), "sha256": np.array(digest), **arrays}
        np.savez_compressed(stream, allow_pickle=False, **headed)
        return stream.getvalue()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the organ file.

        Parameters
        ----------
        path : str | os.PathLike[str]
            The file.

        Raises
        ------
        UserError
            Where it can't be written.
        """
        try:
            Path(path).write_bytes(self.to_bytes())
        except OSError as error:
            raise UserError(f"cannot write organ file {path}: {error.strerror}") from None

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Organ:
        """Read an organ file.

        Parameters
        ----------
        path : str | os.PathLike[str]
            The file.

        Raises
        ------
        UserError
            Where the file is missing, not an organ, truncated, altered, or of an unknown schema version.
        """
        return cls(**read_fields(path, {item.name for item in fields(cls) if "dtype" in item.metadata}))

    def digest(self) -> str:
        """Return the SHA-256 (hex) of the arrays: two organs with the same digest simulate alike."""
        law = self._law()
        text = json.dumps(law, sort_keys=True) if law else ""
        return content_digest(text, self._arrays(without=() if len(self.cell_nodes) else ("cell_",)))

    def _arrays(self, without: tuple[str, ...] = ()) -> dict[str, Array]:
        """Return all arrays except those whose names start so, and those that its schema version doesn't have."""
        if self.schema_version < 5:  # as files were before inclusions existed
            without = (*without, "inclusion_")
        if self.schema_version < 6:
            without = (*without, "virtual_")
        names = (item.name for item in fields(self) if "dtype" in item.metadata)
        return {name: getattr(self, name) for name in names if not name.startswith(without)}


def _frozen(name: str, value: ArrayLike, dtype: type) -> Array:
    given = np.asarray(value)
    if given.dtype.kind not in "fiub":
        raise UserError(f"organ: {name} contains {given.dtype.name}, not numbers")
    with np.errstate(all="ignore"):  # looked at below
        array: Array = np.array(given, dtype=dtype, order="C")
    if dtype is np.float64 and not np.all(np.isfinite(array)):
        raise UserError(f"organ: {name} contains values that are not finite")
    if dtype is np.int32 and not np.array_equal(array, given):
        raise UserError(f"organ: {name} contains values that are not 32-bit integers")
    array.flags.writeable = False
    return array


def _check_shape(name: str, array: Array, shape: tuple[int | str, ...], sizes: dict[str, int]) -> None:
    if array.ndim != len(shape):
        raise UserError(f"organ: {name} must have {len(shape)} dimensions, has {array.ndim}")
    for actual, wanted in zip(array.shape, shape, strict=True):
        expected = sizes.setdefault(wanted, actual) if isinstance(wanted, str) else wanted
        if actual != expected:
            raise UserError(f"organ: {name} has shape {array.shape}, expected {shape} with {wanted} = {expected}")
