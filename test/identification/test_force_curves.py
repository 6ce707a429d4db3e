"""Tables of force against depth: between and beyond their points, and closed forms."""

import numpy as np
import pytest

from tissue_sim.identification.force_curves import bonded_layer, hertz, tabulated

RADIUS, MODULUS, NU = 0.005, 10e3, 0.45


def test_a_few_depths_give_hertz_between_them():
    depth, force = hertz(RADIUS, MODULUS, NU, 0.004)
    knots = np.linspace(-0.0007, 0.004, 14)
    given = np.interp(knots, depth, force, left=0.0)
    curves = tabulated([knots], [given], np.zeros(1, dtype=np.int64))
    wanted = np.array([[0.001, 0.0023, 0.0037]])
    found, slope = curves.at(wanted)
    exact = force[-1] * (wanted / 0.004) ** 1.5
    np.testing.assert_allclose(found, exact, rtol=5e-3)
    np.testing.assert_allclose(slope, 1.5 * exact / wanted, rtol=2e-2)
    assert curves.start[0] == pytest.approx(0.0, abs=2e-5)
    assert (curves.at(np.array([[-0.01, -1e-5]]))[0] == 0.0).all()


def test_beyond_a_table_the_last_slope_holds():
    depth, force = hertz(RADIUS, MODULUS, NU, 0.004)
    curves = tabulated([depth], [force], np.zeros(1, dtype=np.int64))
    (before, after), _ = (one[0] for one in curves.at(np.array([[0.004, 0.005]])))
    assert after - before == pytest.approx(1.5 * before / 0.004 * 0.001, rel=1e-2)


def test_a_thick_layer_is_a_half_space_and_a_thin_one_is_stiffer():
    depth, force = hertz(RADIUS, MODULUS, NU, 0.002)
    assert force[-1] == pytest.approx(4 / 3 * MODULUS / (1 - NU**2) * np.sqrt(RADIUS * depth[-1] ** 3))
    thick, thin = (bonded_layer(RADIUS, MODULUS, NU, 0.002, thickness)[1] for thickness in (10.0, 0.01))
    np.testing.assert_allclose(thick, force, rtol=1e-3)
    assert 1.3 < thin[-1] / force[-1] < 1.6


def test_an_incompressible_layer_has_the_published_factors():
    """Dimitriadis et al. 2002, equation 13, for nu = 0.5: 1 + 1.133 x + 1.283 x^2 + 0.769 x^3 + 0.0975 x^4."""
    depth, force = hertz(RADIUS, MODULUS, 0.5, 0.002)
    fraction = np.sqrt(RADIUS * depth) / 0.02
    factor = np.polynomial.Polynomial([1.0, 1.133, 1.283, 0.769, 0.0975])(fraction)
    np.testing.assert_allclose(bonded_layer(RADIUS, MODULUS, 0.5, 0.002, 0.02)[1], force * factor, rtol=2e-3)
