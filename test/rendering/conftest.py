"""What the tests of pictures share: a context to draw with, or the reason why there is none."""

import pytest

from tissue_sim.errors import UserError


@pytest.fixture(scope="session", autouse=True)
def _can_draw():
    pytest.importorskip("moderngl")
    from tissue_sim.rendering.offscreen import made_context

    try:
        made_context().release()
    except UserError as error:
        pytest.skip(str(error))
