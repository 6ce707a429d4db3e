"""The token in the page's address."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket

from tissue_sim.errors import UserError

TOKEN_VARIABLE = "TISSUE_SIM_TOKEN"
LEAST = 16  # characters of a token: 96 bits can't be guessed
_TOKEN = re.compile(rf"[A-Za-z0-9_-]{{{LEAST},}}")


def is_loopback(host: str) -> bool:
    """Return whether a page at a host reaches this machine only; raise OSError for an invalid address."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return all(ipaddress.ip_address(address[0]).is_loopback for *_, address in found)


def chosen_token(given: str | None, host: str) -> str | None:
    """Return the token that the page at a host needs: the user's, else a new one; none on loopback.

    given: the user's token. Raises UserError when the token could be guessed, or does not fit into an address.
    """
    if given:
        if not _TOKEN.fullmatch(given):
            raise UserError(f"a token is {LEAST} or more of A-Z, a-z, 0-9, _ and -; without one, a random one is made")
        return given
    return None if is_loopback(host) else secrets.token_urlsafe()
