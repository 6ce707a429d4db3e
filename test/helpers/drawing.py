"""Whether this machine can draw without a window."""

import pytest

from tissue_sim.errors import UserError


def require_drawing():
    """Skip where it can't, with the reason."""
    pytest.importorskip("moderngl")
    pytest.importorskip("PIL")
    from tissue_sim.rendering.offscreen import made_context

    try:
        made_context().release()
    except UserError as error:
        pytest.skip(str(error))
