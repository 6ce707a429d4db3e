"""The token in the page's address."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket

from tissue_sim.errors import UserError

TOKEN_VARIABLE = "TISSUE_SIM_TOKEN"
LEAST = 16  # characters of a token: nobody guesses 2^96
_TOKEN = re.compile(rf"[A-Za-z0-9_-]{{{LEAST},}}")


def is_loopback(host: str) -> bool:
    """Whether what is served at a host reaches this machine only. Raises OSError for what is no address."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return all(ipaddress.ip_address(address[0]).is_loopback for *_, address in found)


def chosen_token(given: str | None, host: str) -> str | None:
    """The token that the page at a host needs: the user's, else a new one; none on loopback.

    Raises UserError for one that could be guessed, or does not fit into an address.
    """
    if given:
        if not _TOKEN.fullmatch(given):
            raise UserError(f"a token is {LEAST} or more of A-Z, a-z, 0-9, _ and -; without one, a random one is made")
        return given
    return None if is_loopback(host) else secrets.token_urlsafe()
