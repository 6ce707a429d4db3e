"""Relaxation: tissue is stiffer in a fast deformation than in a held one. One Prony term for the whole organ.

Each node has a force h besides its elastic force f, with dh/dt = g/(1 - g) df/dt - h/T: a Maxwell element beside the
elastic one, the standard linear solid. f is what remains in equilibrium, so that calibrated moduli are those of held
tissue; at first tissue is stiffer by 1/(1 - g). All moduli relax alike, which leaves Poisson's ratio as it is. h
belongs to nodes, not to cells, and keeps its direction: where stressed tissue turns fast, it lags behind.

h returns no more energy than it has received. Its energy E is computed as that of a linear element, dE/dt = -h.v - 2
E/T, and when none is left, h is set to zero: rotating stressed tissue to and fro would otherwise create energy.

References
----------
Simo & Hughes 1998: Computational Inelasticity, chapter 10. Hannaford & Ryu 2002: Time-domain passivity control of
haptic interfaces.
"""

from __future__ import annotations

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.data.arrays import add, copy
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.state import State

LANES = 4  # partial sums, so that no addition waits for the previous one; their order is fixed


def unrelaxed_factor(model: Model) -> float:
    """Return the ratio of the tissue's stiffness before it relaxes to that after, 1 / (1 - g); 1 for elastic tissue.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    return 1.0 + float(model.relaxation[1]) if len(model.relaxation) else 1.0


@kernel
def creep_rate(model: Model) -> float:
    """Return the rate of the slow part of the return of released tissue that relaxes, (1 - g) / T, 1/s.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    return model.relaxation[0] / (1.0 + model.relaxation[1])


@kernel
def relax(model: Model, state: State, force: Floats, step: float) -> None:
    """Add the forces that have not relaxed yet to the elastic forces, once in every substep of the whole organ.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    force : Floats, shape (n, 3), N
        Elastic forces on the nodes; updated.
    step : float, s
        The substep that begins.
    """
    memory = state.relaxing[0]
    last = memory.step
    memory.step = step
    if last == 0.0:
        copy(force, state.last_elastic)
        add(state.unrelaxed, force)  # the part that a cut has left
        return
    half = 0.5 * last * model.relaxation[0]
    kept, taken = (1.0 - half) / (1.0 + half), model.relaxation[1] / (1.0 + half)
    work = 0.5 * last * _advance(state, force, kept, taken)
    memory.energy = ((1.0 - 2.0 * half) * memory.energy - work) / (1.0 + 2.0 * half)
    if memory.energy < 0.0:
        memory.energy = 0.0
        state.unrelaxed[:] = 0.0
        copy(state.last_elastic, force)


@kernel
def _advance(state: State, force: Floats, kept: float, taken: float) -> float:
    """Advance the unrelaxed forces by the trapezoidal rule and add them to force (n, 3) N; return twice their power."""
    size = force.size
    f, before = force.reshape(size), state.last_elastic.reshape(size)
    h, v = state.unrelaxed.reshape(size), state.velocity.reshape(size)
    whole = size - size % LANES
    one = two = three = four = 0.0
    for i in range(0, whole, LANES):
        one += _advance_one(f, before, h, i, kept, taken) * v[i]
        two += _advance_one(f, before, h, i + 1, kept, taken) * v[i + 1]
        three += _advance_one(f, before, h, i + 2, kept, taken) * v[i + 2]
        four += _advance_one(f, before, h, i + 3, kept, taken) * v[i + 3]
    for i in range(whole, size):
        one += _advance_one(f, before, h, i, kept, taken) * v[i]
    return (one + two) + (three + four)


@kernel
def _advance_one(force: Floats, before: Floats, unrelaxed: Floats, i: int, kept: float, taken: float) -> float:
    """Advance one coordinate; return the sum of its unrelaxed forces before and after."""
    old, elastic = unrelaxed[i], force[i]
    new = kept * old + taken * (elastic - before[i])
    before[i], unrelaxed[i], force[i] = elastic, new, elastic + new
    return old + new


@kernel
def forget_relaxation(state: State) -> None:
    """Set the unrelaxed forces to zero, as of tissue that has relaxed in its present shape.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    for index in range(len(state.relaxing)):
        state.relaxing[index].step = state.relaxing[index].energy = 0.0
    state.unrelaxed[:] = 0.0
