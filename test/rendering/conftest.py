"""Tests of pictures need something to draw with."""

import pytest

from helpers.drawing import require_drawing


@pytest.fixture(scope="session", autouse=True)
def _can_draw():
    require_drawing()
