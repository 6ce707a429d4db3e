"""Discretisation error of the finite-element reference, by a finer mesh under the same loads, and its correction.

Settling a nonlinear body takes minutes even on the coarse mesh. The discretisation error is almost entirely one of
linear elasticity, though: a kidney's settled shapes differed by 0.3 to 0.8 % from those of a mesh of four times the
nodes, and with the difference of the two linear answers added by 0.1 to 0.3 %. And few shapes determine it: the
difference under 64 loads gives that under all others to 0.1 % on average.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cases import AXES
from tissue_sim.calibration.checkpoint import Arrays
from tissue_sim.calibration.evaluation import errors
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body

BOUND = 1.0  # %, largest accepted error of the reference
FINER = Grading(clamp=2, growth=0.8)  # and no element under the loads longer than the surface's
# Error of the finer mesh as a fraction of the difference: a third by a mesh of another three times as many nodes (left
# kidney of a CT: 1.2 to 1.6 % and 0.3 to 0.5 %), as elements of half the size have a quarter of the error (Richardson).
LEFT = 1.0 / 3.0
PLACES = 22  # places of the fit's loads that are also computed on the finer mesh
WEAK = 1e-3  # relative strength below which shapes of those answers are left out


class Refined(NamedTuple):
    """Reference mesh and the finer one under c loads."""

    nodes: int
    finer_nodes: int
    difference: Floats  # (c,) %, relative L2 of the two linear answers

    @property
    def worst(self) -> float:
        """Largest error that is left after the correction, %."""
        return LEFT * float(self.difference.max())

    def __str__(self) -> str:
        """Return one line for reports."""
        verdict = "" if self.worst <= BOUND else f" (above {BOUND:g} %)"
        return (
            f"reference of {self.nodes} nodes, corrected by one of {self.finer_nodes} that differs by"
            f" {self.difference.mean():.2f} % on average and {self.difference.max():.2f} % at worst: the remaining"
            f" error is at most {self.worst:.2f} %{verdict}"
        )


def finer_reference_body(body: Body, forces: Floats) -> Body:
    """Return the body on the finer mesh.

    Parameters
    ----------
    body : Body
        The finite-element body.
    forces : Floats, shape (c, n_surface, 3), N
        Loads under which it is refined.

    Raises
    ------
    UserError
        As Body does.
    """
    return Body(body.organ, np.flatnonzero(forces.any(axis=(0, 2))), FINER)


def refined(body: Body, finer: Body, answers: Floats, finer_answers: Floats) -> Refined:
    """Return the difference of the linear answers of a body to those of a finer one.

    Parameters
    ----------
    body : Body
        The finite-element body.
    finer : Body
        The finer body.
    answers : Floats, shape (c, n, 3), m
        Answers of the body.
    finer_answers : Floats, shape (c, n, 3), m
        Answers of the finer body.
    """
    return Refined(body.n_nodes, finer.n_nodes, 100.0 * errors(answers, finer_answers))


def corrected_answers(body: Body, forces: Floats, answers: Floats, samples: Floats) -> Arrays:
    """Return the answers of the finer mesh to loads, and to samples of other loads.

    Parameters
    ----------
    body : Body
        The finite-element body.
    forces : Floats, shape (c, n_surface, 3), N
        Loads.
    answers : Floats, shape (c, n, 3), m
        Answers of the body to them.
    samples : Floats, shape (s, n_surface, 3), N
        Other loads.

    Returns
    -------
    Arrays
        The fields of Refined, and `answers` and `samples`.

    Raises
    ------
    UserError
        As Body does.
    """
    finer = finer_reference_body(body, forces)
    good = finer.settle_linear(forces)
    accuracy = refined(body, finer, answers, good)
    return {**accuracy._asdict(), "answers": good, "samples": finer.settle_linear(samples)}


def samples_of(count: int) -> Longs:
    """Return indices of some cases: all of PLACES places that are spread over them.

    Parameters
    ----------
    count : int
        Number of cases.

    Returns
    -------
    Longs, shape (s,)
        Indices.
    """
    places = np.unique(np.linspace(0, count // AXES - 1, PLACES).astype(np.int64))
    return (AXES * places[:, None] + np.arange(AXES)).ravel()


def corrected(answers: Floats, samples: Floats, finer_samples: Floats) -> Floats:
    """Return answers as a finer mesh would give them, by its answers to samples.

    Every answer is approximated by a combination of the samples' answers, and its difference by the same combination.

    Parameters
    ----------
    answers : Floats, shape (c, n, 3), m
        Answers of the coarse mesh.
    samples : Floats, shape (s, n, 3), m
        Its answers to the samples.
    finer_samples : Floats, shape (s, n, 3), m
        Answers of the finer mesh to the samples.

    Returns
    -------
    Floats, shape (c, n, 3), m
        Corrected answers.
    """
    shapes, strength, mix = np.linalg.svd(samples.reshape(len(samples), -1).T, full_matrices=False)
    some = strength > WEAK * strength[0]
    flat = answers.reshape(len(answers), -1)
    fractions = ((flat @ shapes[:, some]) / strength[some]) @ mix[some]
    difference = (finer_samples - samples).reshape(len(samples), -1)
    good: Floats = (flat + fractions @ difference).reshape(answers.shape)
    return good
