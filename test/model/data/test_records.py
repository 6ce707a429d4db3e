"""Records with fields that are arrays, in Python and in kernels."""

from typing import Annotated

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.records import Record, Vector


class Held(Record):
    """A place that is held."""

    node: Annotated[Longs, (2,)]
    place: Vector
    slope: Annotated[Floats, (2, 3)]
    stiffness: float


@kernel
def pull(held, by):
    held.stiffness += by
    for c in range(3):
        held.place[c] += by
        held.slope[1, c] = held.place[c]
    held.node[1] = 7


@kernel
def pull_each(many):
    for index in range(len(many)):
        pull(many[index], float(index + 1))


def test_fields_are_arrays_that_kernels_write_in_place():
    words = np.zeros(3 * Held.words(), dtype=np.int64)
    many = Held.rows(words)
    assert many.place.shape == (3, 3)
    assert many.slope.shape == (3, 2, 3)
    many.place[:] = [1.0, 2.0, 3.0]
    pull_each(many)
    np.testing.assert_array_equal(many.stiffness, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(many.place, [[2.0, 3.0, 4.0], [3.0, 4.0, 5.0], [4.0, 5.0, 6.0]])
    np.testing.assert_array_equal(many.slope[:, 1], many.place)
    np.testing.assert_array_equal(many.node, [[0, 7]] * 3)
    assert not many.slope[:, 0].any()
    np.testing.assert_array_equal(Held.at(words[-Held.words() :]).place, many.place[2])
