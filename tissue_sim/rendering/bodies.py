"""What is drawn: surfaces of tissue and rigid parts of tools, and their arrays in the graphics processor's memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import moderngl
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from tissue_sim.array_types import Floats, Ints, Longs, Singles
from tissue_sim.errors import UserError

MOST_LABEL = 255


@dataclass(frozen=True)
class Look:
    """How a body looks, and what it is called in a segmentation.

    Attributes
    ----------
    colour : tuple[float, float, float]
        Red, green, blue of the screen (sRGB), 0 to 1.
    label : int
        Its number in a segmentation, 1 to 255; 0 is where nothing is.
    is_metal : bool
        Whether it is polished metal, not moist tissue.
    is_flat : bool
        Whether its triangles are seen as flat, as of a mesh with edges.
    texture : float
        Period of the tissue's texture, m; 0 for none.
    inner : tuple[float, float, float] | None
        Colour of the vertices that are marked as other tissue; None where there is none.
    """

    colour: tuple[float, float, float] = (0.57, 0.20, 0.18)
    label: int = 1
    is_metal: bool = False
    is_flat: bool = False
    texture: float = 0.05
    inner: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.label <= MOST_LABEL:
            raise UserError(f"label {self.label} is outside 1..{MOST_LABEL}")

    @property
    def light(self) -> tuple[float, ...]:
        """Its colour as light of 0 to 1."""
        return light_of(self.colour)


def light_of(colour: tuple[float, float, float]) -> tuple[float, ...]:
    """Return a colour of the screen (sRGB) as light of 0 to 1.

    Parameters
    ----------
    colour : tuple[float, float, float]
        The colour.
    """
    return tuple(((part + 0.055) / 1.055) ** 2.4 if part > 0.04045 else part / 12.92 for part in colour)


class Shape(NamedTuple):
    """A surface as it is drawn: n vertices, t triangles."""

    vertices: Floats  # (n, 3) m at rest, to which the texture sticks
    triangles: Longs  # (t, 3) corner indices, counterclockwise seen from outside
    fraction: Floats  # (n,) 1 for vertices that lie in other tissue, 0 for those that don't


METAL = Look((0.62, 0.64, 0.67), label=101, is_metal=True, is_flat=True, texture=0.0)


class Normals:
    """Normals of a triangulated surface at its vertices, weighted by the triangles' areas.

    Parameters
    ----------
    triangles : Longs | Ints, shape (t, 3)
        Corner indices.
    n_vertices : int
        Number of the vertices.
    """

    def __init__(self, triangles: Longs | Ints, n_vertices: int) -> None:
        self._triangles = triangles
        corners = triangles.ravel()
        faces = np.repeat(np.arange(len(triangles)), 3)
        self._around = csr_array((np.ones(len(corners)), (corners, faces)), shape=(n_vertices, len(triangles)))

    def of(self, positions: Floats) -> Floats:
        """Return unit normals (n, 3), zero where a vertex has no triangle, of positions (n, 3)."""
        first, second, third = (positions[self._triangles[:, corner]] for corner in range(3))
        outward = self._around @ np.cross(second - first, third - first)
        length = np.linalg.norm(outward, axis=1, keepdims=True)
        return np.asarray(outward / np.where(length > 0.0, length, 1.0))


class Body:
    """A body in the memory of the graphics processor.

    Parameters
    ----------
    context : moderngl.Context
        The context.
    programs : dict[str, moderngl.Program]
        The programs that draw it, by name.
    shape : Shape
        Its surface.
    look : Look
        How it looks.

    Attributes
    ----------
    place : Floats, shape (4, 4)
        From its axes to the world's.
    is_shown : bool
        Whether it is drawn.
    """

    def __init__(
        self,
        context: moderngl.Context,
        programs: dict[str, moderngl.Program],
        shape: Shape,
        look: Look,
    ) -> None:
        vertices, triangles, fraction = shape
        self.look, self.is_shown, self.place = look, True, np.eye(4)
        self._normals = Normals(triangles, len(vertices))
        self._numbers = np.zeros((len(vertices), 6), dtype=np.float32)
        self._bounds = np.zeros((2, 3))
        self._write(vertices)
        self._moving = context.buffer(self._numbers.tobytes(), dynamic=True)
        stuck = context.buffer(self._numbers.tobytes())
        faces, fractions = context.buffer(triangles.astype(np.uint32).tobytes()), context.buffer(single_row(fraction))
        self._held = [self._moving, stuck, faces, fractions]
        inputs = [
            (self._moving, "3f 3f", "position", "normal"),
            (stuck, "3f 3f", "rest", "rest_normal"),
            (fractions, "1f", "fraction"),
        ]
        # What the compiler finds that a program doesn't need, it doesn't take.
        self._arrays = {
            name: context.vertex_array(program, inputs, faces, index_element_size=4, skip_errors=True)
            for name, program in programs.items()
        }

    @property
    def count(self) -> int:
        """Number of its vertices."""
        return len(self._numbers)

    @property
    def corners(self) -> Floats:
        """The corners (8, 3) m, in the world, of the box that holds it."""
        grid = np.array(np.meshgrid(*self._bounds.T, indexing="ij")).reshape(3, -1).T
        return np.asarray(grid @ self.place[:3, :3].T + self.place[:3, 3])

    def move(self, vertices: ArrayLike) -> None:
        """Move its vertices (n, 3) m, as it is deformed.

        Parameters
        ----------
        vertices : ArrayLike, shape (n, 3), m
            The vertices.

        Raises
        ------
        UserError
            Where it has another number of them, or one is not finite.
        """
        positions = np.asarray(vertices, dtype=np.float64)
        if positions.shape != (self.count, 3) or not np.isfinite(positions).all():
            raise UserError(f"expected: {self.count} finite positions x, y, z; given: {positions.shape}")
        self._write(positions)
        self._moving.write(self._numbers.tobytes())

    def draw(self, program: str) -> None:
        """Draw it with a program, whose uniforms are set."""
        self._arrays[program].render()

    def release(self) -> None:
        """Free its memory there."""
        for array in self._arrays.values():
            array.release()
        for buffer in self._held:
            buffer.release()

    def _write(self, positions: Floats) -> None:
        self._numbers[:, :3], self._numbers[:, 3:] = positions, self._normals.of(positions)
        self._bounds = np.array([positions.min(axis=0), positions.max(axis=0)])


def checked(vertices: ArrayLike, triangles: ArrayLike, fraction: ArrayLike | None = None) -> Shape:
    """Return a surface.

    Parameters
    ----------
    vertices : ArrayLike, shape (n, 3), m
        Its vertices.
    triangles : ArrayLike, shape (t, 3)
        Corner indices.
    fraction : ArrayLike | None, shape (n,), optional
        1 for vertices that lie in other tissue, 0 for others; by default none does.

    Raises
    ------
    UserError
        Where they are not a surface.
    """
    points, faces = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise UserError(f"vertices of shape {points.shape}; expected: (n, 3), finite")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise UserError(f"triangles of shape {faces.shape}; expected: (t, 3)")
    if faces.min() < 0 or faces.max() >= len(points):
        raise UserError(f"triangles name vertex {faces.max()} of {len(points)}")
    fractions = np.zeros(len(points)) if fraction is None else np.asarray(fraction, dtype=np.float64)
    if fractions.shape != (len(points),):
        raise UserError(f"fractions of shape {fractions.shape}; expected: ({len(points)},)")
    return Shape(points, faces, fractions)


def single_row(values: Floats) -> bytes:
    """Return numbers as OpenGL takes them: float32."""
    made: Singles = np.ascontiguousarray(values, dtype=np.float32)
    return made.tobytes()


def single(matrix: Floats) -> bytes:
    """Return a matrix as OpenGL takes it: float32, one column after the other."""
    made: Singles = np.ascontiguousarray(matrix.T, dtype=np.float32)
    return made.tobytes()
