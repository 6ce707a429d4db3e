"""Command `tissue_sim view`: a running node in the browser."""

from __future__ import annotations

import argparse
import errno
import os
import socket
import sys

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.ros.shared import client
from tissue_sim.ros.viewer.tokens import TOKEN_VARIABLE, chosen_token

FRAME_TIME = 1.0 / 40.0  # s between two pictures: a few a second come late, and 30 must remain
PATIENCE = 5.0  # s for the answer of a page that holds a tool
IDLE_TIME = 0.2  # s between two checks while no browser is connected


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_page_arguments(parser)
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    parser.add_argument("--tools", type=client.names, help="names of the tools (default: the node's)")
    parser.add_argument(
        "--layout",
        choices=("rviz", "foxglove"),
        help="print a layout of that viewer for the node, instead of serving a page",
    )
    parser.add_argument(
        "--patience",
        type=client.number(0.1, 3600.0, "s"),
        default=PATIENCE,
        help="seconds without an answer after which a page loses control of its tool",
    )


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of every command that serves the page."""
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address at which the page is served; 0.0.0.0 serves it to other machines, which need the token",
    )
    parser.add_argument("--port", type=client.port_number, default=8080, help="port at which the page is served")
    parser.add_argument(
        "--token",
        help=f"token at the end of the page's address, so that it can be bookmarked (default: ${TOKEN_VARIABLE};"
        " otherwise a new one at each start if --host serves other machines, and none if it doesn't)",
    )


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGINT or SIGTERM; return 0; raise UserError when it can't be served."""
    if args.layout:
        from tissue_sim.ros.viewer.layout import write

        return write(args.layout, args.node)
    check_port(args.host, args.port)
    token = page_token(args)
    try:
        from tissue_sim.rendering.page_server import serving
    except ImportError:
        raise UserError("the viewer needs viser: pip install viser") from None
    with (
        client.Stop() as stop,
        serving(args.host, args.port, token) as server,
        client.client_node("viewer", args.node) as node,
    ):
        from tissue_sim.ros.viewer.loop import Viewer

        progress.report_by(None)  # no progress thread beside the pictures
        print(f"open {address(args.host, args.port, token)}", flush=True)
        viewer = Viewer(server, node, args.node, args.tools, args.patience)
        # Short turns at the GIL: the poses of a held tool must not wait for a picture.
        sys.setswitchinterval(0.001)
        try:
            client.repeat(stop, lambda: max(FRAME_TIME, viewer.picture_time) if viewer.update() else IDLE_TIME)
        finally:
            viewer.close()
    return 0


def check_port(host: str, port: int) -> None:
    """Check that a page can be served at a host and port.

    Raises UserError when it can't; the message has the remedy.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen(1)
    except (socket.gaierror, UnicodeError):
        raise UserError(
            f"'{host}' is not an address; use --host 127.0.0.1, or 0.0.0.0 for all addresses of this machine"
        ) from None
    except PermissionError:
        raise UserError(f"port {port} needs more rights; choose one above 1023 with --port") from None
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise UserError(f"port {port} of {host} is taken; choose another with --port") from None
        raise UserError(f"cannot serve at {host}:{port}: {error.strerror}; choose another --host") from None


def page_token(args: argparse.Namespace) -> str | None:
    """Return the token that the page needs, or None.

    Raises UserError when it is invalid.
    """
    return chosen_token(args.token or os.environ.get(TOKEN_VARIABLE), args.host)


def address(host: str, port: int, token: str | None) -> str:
    """Return the address to open in a browser on this machine."""
    page = f"http://{shown_host(host)}:{port}"
    return page if token is None else f"{page}/?token={token}"


def shown_host(host: str) -> str:
    """Return a host as it reads in an address that works in a browser on this machine."""
    return {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
