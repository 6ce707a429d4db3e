"""Substep of the hybrid tick written in C, against which the kernels are measured.

Springs, hinges and return springs, or cells, and symplectic Euler, on the same arrays and in the same order as
model.forces, model.cells and model.integrators, compiled by the C compiler of this machine.
"""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.bench.timing import clock_cost
from tissue_sim.model.data.blocks import BLOCK, Blocks, empty_blocks
from tissue_sim.model.data.model import Tissue
from tissue_sim.model.elasticity.cell_law import COMPRESSED, STEEPEST
from tissue_sim.model.elasticity.cells import CONSTANTS
from tissue_sim.model.elasticity.forces import SHORTEST, elastic_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.integrators import symplectic_euler

PLAIN = ("-O3",)
# The last two options allow vectorised square roots and selections, as Numba's compiler does.
NATIVE = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math")
COMPILER = "cc"
NUMBERS = (BLOCK, CONSTANTS, SHORTEST, SHORTEST, STEEPEST, COMPRESSED, 1.0 / STEEPEST**2)  # in the order of the source
COMPARED = 200  # substeps after which positions are compared
AGREEMENT = 1e-10  # largest difference of positions, over the largest displacement


class CLoopError(Exception):
    """Error raised where there is no C compiler, it fails, or its result differs from the kernels'."""


SOURCE = r"""
#include <math.h>
#include <string.h>
#include <time.h>

enum { BLOCK = %d, CONSTANTS = %d };

typedef struct {
    long n, n_cells, n_edges, n_links, n_returning, n_moving;
    const int *cell;
    const double *cell_constants;
    const int *edge;
    const double *edge_constants;
    const int *link;
    const double *link_constants;
    const int *returning;
    const double *target, *return_stiffness;
    const int *moving;
    const double *inverse_mass, *damping;
    const double *load;
} Model;

static double largest(double a, double b)
{
    return a > b ? a : b;
}

static void spring_forces(const Model *m, const double *restrict x, double *restrict w, double *restrict f)
{
    for (long block = 0; block < m->n_links; block++) {
        const int *restrict ends = m->link + 2 * BLOCK * block;
        const double *restrict c = m->link_constants + 2 * BLOCK * block;
        for (int s = 0; s < BLOCK; s++) {
            const long i = 3L * ends[2 * s], j = 3L * ends[2 * s + 1];
            w[s] = x[j] - x[i];
            w[BLOCK + s] = x[j + 1] - x[i + 1];
            w[2 * BLOCK + s] = x[j + 2] - x[i + 2];
        }
        for (int s = 0; s < BLOCK; s++) {
            const double dx = w[s], dy = w[BLOCK + s], dz = w[2 * BLOCK + s];
            const double stretch = largest(sqrt(dx * dx + dy * dy + dz * dz) * c[s], %r);
            const double pull = c[BLOCK + s] * (1.0 - 1.0 / stretch);
            w[s] = pull * dx;
            w[BLOCK + s] = pull * dy;
            w[2 * BLOCK + s] = pull * dz;
        }
        for (int s = 0; s < BLOCK; s++) {
            const long i = 3L * ends[2 * s], j = 3L * ends[2 * s + 1];
            for (int axis = 0; axis < 3; axis++) {
                f[i + axis] += w[axis * BLOCK + s];
                f[j + axis] -= w[axis * BLOCK + s];
            }
        }
    }
}

/* From the first node of each of a block to its other three. */
static inline void gather_arms(const int *restrict nodes, const double *restrict x, double *restrict w)
{
    for (int e = 0; e < BLOCK; e++) {
        const long i = 3L * nodes[4 * e];
        for (int arm = 0; arm < 3; arm++) {
            const long j = 3L * nodes[4 * e + 1 + arm];
            for (int axis = 0; axis < 3; axis++)
                w[(3 * arm + axis) * BLOCK + e] = x[j + axis] - x[i + axis];
        }
    }
}

static void edge_forces(const Model *m, const double *restrict x, double *restrict w, double *restrict f)
{
    for (long block = 0; block < m->n_edges; block++) {
        const int *restrict ends = m->edge + 4 * BLOCK * block;
        const double *restrict c = m->edge_constants + 8 * BLOCK * block;
        gather_arms(ends, x, w);
        for (int e = 0; e < BLOCK; e++) {
            const double ex = w[e], ey = w[BLOCK + e], ez = w[2 * BLOCK + e];
            const double kx = w[3 * BLOCK + e], ky = w[4 * BLOCK + e], kz = w[5 * BLOCK + e];
            const double lx = w[6 * BLOCK + e], ly = w[7 * BLOCK + e], lz = w[8 * BLOCK + e];
            const double wj = c[e], wk = c[BLOCK + e], wl = c[2 * BLOCK + e];
            const double bx = wj * ex + wk * kx + wl * lx;
            const double by = wj * ey + wk * ky + wl * ly;
            const double bz = wj * ez + wk * kz + wl * lz;
            const double dx = kx - lx, dy = ky - ly, dz = kz - lz;
            double nx = ey * dz - ez * dy, ny = ez * dx - ex * dz, nz = ex * dy - ey * dx;
            const double square = nx * nx + ny * ny + nz * nz, least = c[5 * BLOCK + e];
            const double inverse = 1.0 / sqrt(largest(square, least));
            nx *= inverse; ny *= inverse; nz *= inverse;
            const double bent = bx * nx + by * ny + bz * nz;
            const double push = -c[4 * BLOCK + e] * (bent - c[3 * BLOCK + e]);
            const double along = square > least ? bent : 0.0, turn = push * inverse;
            const double gx = (bx - along * nx) * turn, gy = (by - along * ny) * turn, gz = (bz - along * nz) * turn;
            const double px = push * nx, py = push * ny, pz = push * nz;
            const double cx = gy * ez - gz * ey, cy = gz * ex - gx * ez, cz = gx * ey - gy * ex;
            const double stretch = largest(sqrt(ex * ex + ey * ey + ez * ez) * c[6 * BLOCK + e], %r);
            const double pull = c[7 * BLOCK + e] * (1.0 / stretch - 1.0);
            w[e] = wj * px + dy * gz - dz * gy + pull * ex;
            w[BLOCK + e] = wj * py + dz * gx - dx * gz + pull * ey;
            w[2 * BLOCK + e] = wj * pz + dx * gy - dy * gx + pull * ez;
            w[3 * BLOCK + e] = wk * px + cx;
            w[4 * BLOCK + e] = wk * py + cy;
            w[5 * BLOCK + e] = wk * pz + cz;
            w[6 * BLOCK + e] = wl * px - cx;
            w[7 * BLOCK + e] = wl * py - cy;
            w[8 * BLOCK + e] = wl * pz - cz;
        }
        for (int e = 0; e < BLOCK; e++) {
            const long i = 3L * ends[4 * e], j = 3L * ends[4 * e + 1];
            const long k = 3L * ends[4 * e + 2], l = 3L * ends[4 * e + 3];
            for (int axis = 0; axis < 3; axis++) {
                const double on_j = w[axis * BLOCK + e], on_k = w[(3 + axis) * BLOCK + e];
                const double on_l = w[(6 + axis) * BLOCK + e];
                f[i + axis] -= on_j + on_k + on_l;
                f[j + axis] += on_j;
                f[k + axis] += on_k;
                f[l + axis] += on_l;
            }
        }
    }
}

static void cell_forces(const Model *m, const double *restrict x, double *restrict w, double *restrict f)
{
    for (long block = 0; block < m->n_cells; block++) {
        const int *restrict corners = m->cell + 4 * BLOCK * block;
        const double *restrict c = m->cell_constants + CONSTANTS * BLOCK * block;
        gather_arms(corners, x, w);
        for (int e = 0; e < BLOCK; e++) {
            const double jx = w[e], jy = w[BLOCK + e], jz = w[2 * BLOCK + e];
            const double kx = w[3 * BLOCK + e], ky = w[4 * BLOCK + e], kz = w[5 * BLOCK + e];
            const double mx = w[6 * BLOCK + e], my = w[7 * BLOCK + e], mz = w[8 * BLOCK + e];
            const double ax = ky * mz - kz * my, ay = kz * mx - kx * mz, az = kx * my - ky * mx;
            const double bx = my * jz - mz * jy, by = mz * jx - mx * jz, bz = mx * jy - my * jx;
            const double dx = jy * kz - jz * ky, dy = jz * kx - jx * kz, dz = jx * ky - jy * kx;
            const double volume = (jx * ax + jy * ay + jz * az) * c[6 * BLOCK + e];
            const double bounded = largest(volume, %r), inverse = 1.0 / bounded;
            const double bulk = c[7 * BLOCK + e], shear = c[8 * BLOCK + e];
            const double under = -largest(%r - volume, 0.0), steep = bulk + (bulk + shear) * %r;
            const double pressure = bulk * (bounded - inverse) - shear * inverse + (volume - bounded) * steep
                                    + under * c[9 * BLOCK + e];
            const double s11 = c[e], s12 = c[BLOCK + e], s13 = c[2 * BLOCK + e];
            const double s22 = c[3 * BLOCK + e], s23 = c[4 * BLOCK + e], s33 = c[5 * BLOCK + e];
            w[e] = s11 * jx + s12 * kx + s13 * mx + pressure * ax;
            w[BLOCK + e] = s11 * jy + s12 * ky + s13 * my + pressure * ay;
            w[2 * BLOCK + e] = s11 * jz + s12 * kz + s13 * mz + pressure * az;
            w[3 * BLOCK + e] = s12 * jx + s22 * kx + s23 * mx + pressure * bx;
            w[4 * BLOCK + e] = s12 * jy + s22 * ky + s23 * my + pressure * by;
            w[5 * BLOCK + e] = s12 * jz + s22 * kz + s23 * mz + pressure * bz;
            w[6 * BLOCK + e] = s13 * jx + s23 * kx + s33 * mx + pressure * dx;
            w[7 * BLOCK + e] = s13 * jy + s23 * ky + s33 * my + pressure * dy;
            w[8 * BLOCK + e] = s13 * jz + s23 * kz + s33 * mz + pressure * dz;
        }
        for (int e = 0; e < BLOCK; e++) {
            const long i = 3L * corners[4 * e];
            for (int arm = 0; arm < 3; arm++) {
                const long j = 3L * corners[4 * e + 1 + arm];
                for (int axis = 0; axis < 3; axis++) {
                    const double pull = w[(3 * arm + axis) * BLOCK + e];
                    f[i + axis] += pull;
                    f[j + axis] -= pull;
                }
            }
        }
    }
}

static void return_forces(const Model *m, const double *restrict x, double *restrict f)
{
    for (long r = 0; r < m->n_returning; r++) {
        const long node = m->returning[r], i = 3 * node;
        for (int c = 0; c < 3; c++)
            f[i + c] += m->return_stiffness[node] * (m->target[i + c] - x[i + c]);
    }
}

static void symplectic_euler(const Model *m, double *restrict x, double *restrict v, const double *restrict f,
                             double step)
{
    for (long a = 0; a < m->n_moving; a++) {
        const long node = m->moving[a], i = 3 * node;
        const double push = step * m->inverse_mass[node];
        const double shrink = 1.0 / (1.0 + push * m->damping[node]);
        for (int c = 0; c < 3; c++) {
            v[i + c] = (v[i + c] + push * f[i + c]) * shrink;
            x[i + c] += step * v[i + c];
        }
    }
}

/* Step `substeps` times; returns the ns of processor time that it took. */
long long run(const Model *m, double *x, double *v, double *f, double step, long substeps)
{
    double work[9 * BLOCK];
    struct timespec start, end;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &start);
    for (long k = 0; k < substeps; k++) {
        memset(f, 0, 3 * m->n * sizeof *f);
        if (m->n_cells) {
            cell_forces(m, x, work, f);
        } else {
            edge_forces(m, x, work, f);
            spring_forces(m, x, work, f);
            return_forces(m, x, f);
        }
        for (long i = 0; i < 3 * m->n; i++)
            f[i] += m->load[i];
        symplectic_euler(m, x, v, f, step);
    }
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &end);
    return 1000000000LL * (end.tv_sec - start.tv_sec) + (end.tv_nsec - start.tv_nsec);
}
"""


_NUMBERS = ("n", "n_cells", "n_edges", "n_links", "n_returning", "n_moving")
_ARRAYS = (
    *("cell", "cell_constants"),
    *("edge", "edge_constants", "link", "link_constants", "returning", "target", "return_stiffness"),
    *("moving", "inverse_mass", "damping", "load"),
)


class _Model(ctypes.Structure):
    """Struct Model of the source: numbers, then addresses of arrays."""

    _fields_ = [
        *((name, ctypes.c_long) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
    ]


class CLoop:
    """Bursts of substeps in C of a simulation's model under forces.

    flags: flags of the compiler; nodes (k,): loaded nodes; forces (k, 3) N: forces on them. Raises CLoopError where
    there is no compiler, or the result is not that of the kernels.
    """

    def __init__(
        self, simulation: Simulation, flags: tuple[str, ...], nodes: NDArray[np.int64], forces: Floats
    ) -> None:
        model = simulation.model
        self._simulation = simulation
        self._substeps = int(simulation.settings.substeps)
        self._step = float(simulation.settings.tick_time) / self._substeps
        self._load = np.zeros_like(model.rest)
        self._load[nodes] = forces
        edges, links = model.edges, model.links
        cells: Tissue | Blocks = empty_blocks(0, 4, CONSTANTS) if model.tissue is None else model.tissue
        lengths = (len(part) for part in (cells.nodes, edges.nodes, links.nodes, model.return_nodes, model.moving))
        numbers = (len(model.rest), *lengths)
        # The kernels' own arrays, kept alive by being kept here.
        self._arrays = (
            *(cells.nodes, cells.constants),
            *(edges.nodes, edges.constants, links.nodes, links.constants),
            *(model.return_nodes, model.rest, model.return_stiffness),
            *(model.moving, model.inverse_mass, model.damping, self._load),
        )
        self._model = _Model(*numbers, *(array.ctypes.data for array in self._arrays))
        self._run = _library(flags).run
        self._run.restype = ctypes.c_longlong
        self._run.argtypes = [ctypes.POINTER(_Model), *[ctypes.c_void_p] * 3, ctypes.c_double, ctypes.c_long]
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self.position = self._simulation.model.rest.copy()
        self.velocity = np.zeros_like(self.position)
        self._force = np.zeros_like(self.position)

    def advance(self, substeps: int) -> float:
        """Run substeps; return the seconds that they took."""
        arrays = (array.ctypes.data for array in (self.position, self.velocity, self._force))
        return 1e-9 * float(self._run(ctypes.byref(self._model), *arrays, self._step, substeps))

    def __call__(self, count: int) -> Floats:
        """Return the seconds (count,) of a substep, each the mean of a tick's, after two ticks that warm the caches."""
        seconds = np.array([self.advance(self._substeps) for _ in range(count + 2)])[2:]
        return np.maximum(seconds - clock_cost(), 0.0) / self._substeps

    def compare(self) -> float:
        """Return the difference from the kernels after 200 substeps, over the largest displacement, from rest.

        Raises CLoopError when it is more than 1e-10.
        """
        self.reset()
        self.advance(COMPARED)
        model = self._simulation.model
        position, velocity = model.rest.copy(), np.zeros_like(model.rest)
        for _ in range(COMPARED):
            force = np.zeros_like(position)
            elastic_forces(model, position, 1.0, force)
            force += self._load
            symplectic_euler(
                position, velocity, force, model.moving, model.inverse_mass, model.damping, 1.0, self._step
            )
        moved = float(np.abs(position - model.rest).max())
        difference = float(np.abs(self.position - position).max()) / moved
        if not difference <= AGREEMENT:
            raise CLoopError(f"the C loop differs from the kernels by {difference:.0e}")
        return difference


def _library(flags: tuple[str, ...]) -> ctypes.CDLL:
    """Return the source compiled with flags, and loaded."""
    compiler = shutil.which(COMPILER)
    if compiler is None:
        raise CLoopError("no C compiler")
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as folder:
        source, library = Path(folder) / "loop.c", Path(folder) / "loop.so"
        source.write_text(SOURCE % NUMBERS, encoding="utf-8")
        words = [compiler, *flags, "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode:
            raise CLoopError(f"{COMPILER} {' '.join(flags)} fails: {(done.stderr.splitlines() or ['?'])[0]}")
        # Once it is loaded, the file may be removed.
        return ctypes.CDLL(str(library))
