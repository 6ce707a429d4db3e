"""Figures: a PNG of the size that is asked for, with two of the four lines around it."""

import io

import matplotlib.image
import pytest

from tissue_sim.figures import empty_figure, hide_box, png


def test_a_figure_is_a_picture_of_its_size():
    figure = empty_figure(2.0, 1.0)
    axis = figure.subplots()
    hide_box(axis)
    assert {side for side, line in axis.spines.items() if line.get_visible()} == {"left", "bottom"}
    picture = matplotlib.image.imread(io.BytesIO(png(figure, 50)), format="png")
    assert picture.shape[:2] == pytest.approx((50, 100))
