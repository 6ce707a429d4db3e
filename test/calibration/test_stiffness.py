"""What a calibration begins with, and how an organ takes up what it finds."""

import numpy as np
import pytest

from helpers.scenes import ball, changed
from tissue_sim.calibration.stiffness import (
    CELL_START,
    INTERIOR_FRACTION,
    RETURN_START,
    Settings,
    first_stiffness,
    prepared,
    with_stiffness,
)
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.modes import strains_of


def test_cells_fill_the_organ_and_groups_take_it_as_it_is():
    cells = prepared(ball(2), Settings())
    for aim, fraction in INTERIOR_FRACTION.items():
        assert prepared(ball(2), Settings(aim=aim)).n_interior == round(fraction * cells.n_surface)
    assert cells.n_interior == round(INTERIOR_FRACTION["balanced"] * cells.n_surface)
    assert prepared(cells, Settings(interior=30)).n_interior == 30
    mu, lam = cells.lame_moduli
    np.testing.assert_allclose(cells.cell_mu, CELL_START[0] * mu)
    np.testing.assert_allclose(cells.cell_lambda, CELL_START[1] * lam)
    groups = prepared(ball(2), Settings(method="groups"))
    assert groups.n_interior == ball(2).n_interior
    assert not len(prepared(cells, Settings(method="groups")).cell_nodes)
    with pytest.raises(UserError, match="unknown method 'best'"):
        prepared(ball(2), Settings(method="best"))
    with pytest.raises(UserError, match="unknown aim 'speed'; choose one of fast, balanced, accurate"):
        prepared(ball(2), Settings(aim="speed"))


@pytest.mark.parametrize("method", ["cells", "groups"])
def test_what_is_found_is_taken_up_in_the_same_order(method):
    organ = prepared(changed(ball(2), return_stiffness=0.05), Settings(method=method))
    model = assemble(organ)
    first = first_stiffness(organ, model)
    again = first_stiffness(with_stiffness(organ, model, 2.0 * first), model)
    if method == "groups":
        pulls = len(model.return_nodes)
        np.testing.assert_allclose(first[-pulls:], RETURN_START * organ.return_stiffness[model.return_nodes])
        made = strains_of(assemble(with_stiffness(organ, model, 2.0 * first))).stiffness
        np.testing.assert_allclose(made, 2.0 * first)
        assert not with_stiffness(organ, model, first).return_stiffness[organ.fixed].any()
    else:
        np.testing.assert_allclose(again, 2.0 * first)
