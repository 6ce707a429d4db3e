"""Access control of the page and its websocket.

viser answers both on one port and has no hook for that: this is the only place that patches it.
"""

from __future__ import annotations

import contextlib
import gzip
import http
import ipaddress
import secrets
from collections.abc import Callable, Iterator
from functools import lru_cache
from unittest.mock import patch
from urllib.parse import parse_qs, urlsplit

from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from tissue_sim.errors import UserError

TITLE = "tissue_sim"  # of the page, in the browser's tab

type Answer = Callable[[ServerConnection, Request], Response | None]


class Guard:
    """Filter of requests, which answers 403: without the token where there is one, else for a foreign host name.

    On loopback, where there is no token, a web page that the user has open elsewhere is kept out: the browser sends its
    origin, and a name that was made to point here (DNS rebinding) appears as the host.

    Parameters
    ----------
    token : str | None
        The token, or None on loopback.
    port : int
        Port of the page.
    frames : str, optional
        Pages besides itself that may show it in a frame, as a Content-Security-Policy names them.
    """

    def __init__(self, token: str | None, port: int, frames: str = "") -> None:
        self._token = token
        self._frames = f"frame-ancestors 'self' {frames}".rstrip()
        self._cookie = f"tissue_sim_{port}"  # cookies of one host are shared by its ports

    def refusal(self, request: Request) -> str:
        """Return why a request is refused, in a line; empty when it isn't.

        Parameters
        ----------
        request : Request
            The request.
        """
        host = ",".join(request.headers.get_all("Host"))
        if any(urlsplit(origin).netloc != host for origin in request.headers.get_all("Origin")):
            return "only the page itself may open its websocket"
        if self._token is not None:
            known = any(self._is_token(word) for word in (*self._in_address(request), *self._in_cookies(request)))
            return "" if known else "the address of this page ends with ?token=..., as 'tissue_sim view' prints it"
        return (
            ""
            if _is_loopback_name(host)
            else "this page is served under the names of this machine only, or with --token"
        )

    def _is_token(self, word: str) -> bool:
        return secrets.compare_digest(word.encode(errors="replace"), (self._token or "").encode())

    @staticmethod
    def _in_address(request: Request) -> list[str]:
        return parse_qs(urlsplit(request.path).query, max_num_fields=None).get("token", [])

    def _in_cookies(self, request: Request) -> list[str]:
        pairs = (pair.strip().partition("=") for line in request.headers.get_all("Cookie") for pair in line.split(";"))
        return [value for name, _, value in pairs if name == self._cookie]

    def before(self, answer: Answer) -> Answer:
        """Return a function that answers requests in place of viser's, which then sees only those not refused.

        Parameters
        ----------
        answer : Answer
            viser's function.
        """

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            try:
                refused = self.refusal(request)
            except ValueError:  # raised for a malformed address
                refused = "this request is invalid"
            if refused:
                return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refused}\n")
            response = answer(connection, request)
            if response is not None:
                response.body = titled(bytes(response.body))
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
                response.headers["Content-Security-Policy"] = self._frames
                response.headers["Referrer-Policy"] = "no-referrer"
                if self._token is not None:
                    # The page opens its websocket without what follows the ? of its address.
                    cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
                    response.headers["Set-Cookie"] = cookie
            return response

        return guarded


@lru_cache(maxsize=2)
def titled(page: bytes) -> bytes:
    """Return viser's page, which may be compressed, with our name for it; anything else as it is."""
    is_compressed = page.startswith(b"\x1f\x8b")
    plain = gzip.decompress(page) if is_compressed else page
    named = plain.replace(b"<title>Viser</title>", f"<title>{TITLE}</title>".encode(), 1)
    if named is plain or named == plain:
        return page
    return gzip.compress(named, mtime=0) if is_compressed else named


def _is_loopback_name(host: str) -> bool:
    """Return whether a Host header names this machine by loopback."""
    name = urlsplit(f"//{host}").hostname or ""
    if name == "localhost" or name.endswith(".localhost"):  # no DNS answers for these (RFC 6761)
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False


@contextlib.contextmanager
def guarding(guard: Guard) -> Iterator[None]:
    """Check the requests of a viser server that is made meanwhile.

    Parameters
    ----------
    guard : Guard
        Checks them.

    Raises
    ------
    UserError
        When viser doesn't call it.
    """
    from websockets.asyncio import server

    serve: Callable[..., object] = server.serve
    made = []

    def guarded_serve(*words: object, process_request: Answer, **named: object) -> object:
        made.append(process_request)
        return serve(*words, process_request=guard.before(process_request), **named)

    with patch.object(server, "serve", guarded_serve):
        yield
    if not made:
        raise UserError("the access of this version of viser can't be restricted; install viser==1.1.1")
