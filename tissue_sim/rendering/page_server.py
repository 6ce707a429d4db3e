"""A page that viser serves: silent on the terminal, at one port, guarded."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator

import viser

from tissue_sim.errors import UserError
from tissue_sim.rendering.guard import Guard, guarding

LOOPBACK = "127.0.0.1"
NOTEBOOKS = "http://localhost:* http://127.0.0.1:*"  # pages of this machine that may show one of its scenes


def started(host: str, port: int, token: str | None, frames: str = "") -> viser.ViserServer:
    """Return a server, which serves at this port, guarded, or not at all.

    Parameters
    ----------
    host : str
        Its host.
    port : int
        Its port.
    token : str | None
        As in Guard.
    frames : str, optional
        As in Guard.

    Raises
    ------
    UserError
        Where the port is taken.
    """
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with contextlib.redirect_stdout(io.StringIO()), guarding(Guard(token, port, frames)):
        server = viser.ViserServer(host=host, port=port, label="tissue_sim", verbose=False)
    if server.get_port() != port:
        stopped(server)
        raise UserError(f"port {port} of {host} is taken; choose another one")
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


def stopped(server: viser.ViserServer) -> None:
    """Stop a server, silently."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


@contextlib.contextmanager
def serving(host: str, port: int, token: str | None) -> Iterator[viser.ViserServer]:
    """Provide a server as `started` does, and stop it afterwards.

    Parameters
    ----------
    host : str
        Its host.
    port : int
        Its port.
    token : str | None
        As in Guard.

    Yields
    ------
    Iterator[viser.ViserServer]
        the server
    """
    server = started(host, port, token)
    try:
        yield server
    finally:
        stopped(server)
