"""What the finite-element reference lacks, by a finer mesh under the same loads, and its answers with that made good.

Settling a nonlinear body takes minutes even on the coarse mesh. What that mesh is off by is a matter of linear
elasticity nearly alone, though: a kidney's settled shapes were off by 0.3 to 0.8 % of those of a mesh of four times the
nodes, and with the difference of the two linear answers added by 0.1 to 0.3 %. And it is a matter of few shapes: what
64 loads say of it holds for all others to 0.1 % in the mean.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cases import AXES
from tissue_sim.calibration.checkpoint import Arrays
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.judge import errors

BOUND = 1.0  # %, what the reference may be off
FINER = Grading(clamp=2, growth=0.8)  # and no element under the loads longer than the surface's
# Of the difference to the finer mesh, what that is off itself: a third by a mesh of another three times as many nodes
# (left kidney of a CT: 1.2 to 1.6 % and 0.3 to 0.5 %), as elements of half the size are off by a quarter (Richardson).
LEFT = 1.0 / 3.0
PLACES = 22  # of the fit's loads that are answered on the finer mesh, too
WEAK = 1e-3  # shapes that the answers to those hardly have are left out


class Refined(NamedTuple):
    """The reference's mesh and the finer one under c loads."""

    nodes: int
    finer_nodes: int
    difference: Floats  # (c,) %, relative L2 of the two linear answers

    @property
    def worst(self) -> float:
        """What is left at worst when the difference is made good, %."""
        return LEFT * float(self.difference.max())

    def __str__(self) -> str:
        """One line for reports."""
        verdict = "" if self.worst <= BOUND else f" (above {BOUND:g} %)"
        return (
            f"reference of {self.nodes} nodes, corrected by one of {self.finer_nodes} that differs by"
            f" {self.difference.mean():.2f} % on average and {self.difference.max():.2f} % at worst: the remaining"
            f" error is at most {self.worst:.2f} %{verdict}"
        )


def finer_body(body: Body, forces: Floats) -> Body:
    """The body on the finer mesh, for loads (c, n_surface, 3) N. Raises UserError as Body does."""
    return Body(body.organ, np.flatnonzero(forces.any(axis=(0, 2))), FINER)


def refined(body: Body, finer: Body, answers: Floats, finer_answers: Floats) -> Refined:
    """How far the linear answers (c, n, 3) m of a body are off those of a finer one."""
    return Refined(body.n_nodes, finer.n_nodes, 100.0 * errors(answers, finer_answers))


def answers_made_good(body: Body, forces: Floats, answers: Floats, samples: Floats) -> Arrays:
    """What the finer mesh makes of c loads whose answers (c, n, 3) m by the body are known, and of samples.

    The fields of Refined, and `answers` and `samples`. Raises UserError as Body does.
    """
    finer = finer_body(body, forces)
    good = finer.settle_linear(forces)
    accuracy = refined(body, finer, answers, good)
    return {**accuracy._asdict(), "answers": good, "samples": finer.settle_linear(samples)}


def samples_of(count: int) -> Longs:
    """Some of so many cases, all of PLACES places that are spread over them."""
    places = np.unique(np.linspace(0, count // AXES - 1, PLACES).astype(np.int64))
    return (AXES * places[:, None] + np.arange(AXES)).ravel()


def made_good(answers: Floats, samples: Floats, finer_samples: Floats) -> Floats:
    """Answers (c, n, 3) m as a finer mesh would give them, by what it makes of samples (s, n, 3) m.

    Every answer is put together of the samples' as well as can be, and so is its difference.
    """
    shapes, strength, mix = np.linalg.svd(samples.reshape(len(samples), -1).T, full_matrices=False)
    some = strength > WEAK * strength[0]
    flat = answers.reshape(len(answers), -1)
    shares = ((flat @ shapes[:, some]) / strength[some]) @ mix[some]
    difference = (finer_samples - samples).reshape(len(samples), -1)
    good: Floats = (flat + shares @ difference).reshape(answers.shape)
    return good
