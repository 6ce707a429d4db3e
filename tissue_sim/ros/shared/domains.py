"""A ROS domain that no other process on this machine uses, nor is about to use."""

from __future__ import annotations

import random
import socket
from collections.abc import Iterator, MutableMapping
from contextlib import ExitStack, contextmanager

from tissue_sim.errors import UserError
from tissue_sim.ros.shared.dds import LAST_OWN_DOMAIN, limit_to_this_machine

DOMAINS = range(1, LAST_OWN_DOMAIN + 1)
PARTICIPANTS = 4  # of a domain that are checked


def claim_domain() -> tuple[int, socket.socket]:
    """Return a free ROS domain, and the socket that keeps others from claiming it until it is closed.

    Participants come and go in a domain that is in use, so their ports alone don't show it.

    Raises UserError when none is free.
    """
    for domain in random.sample(DOMAINS, len(DOMAINS)):
        # Ports of a domain (DDSI-RTPS 9.6.1): its first two and those from the tenth on are for participants, the
        # third one is unused, and so can hold the claim.
        first = 7400 + 250 * domain
        claim = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            claim.bind(("127.0.0.1", first + 2))
            with ExitStack() as probes:
                for participant in range(PARTICIPANTS):
                    probe = probes.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    probe.bind(("", first + 10 + 2 * participant))
        except OSError:
            claim.close()
            continue
        return domain, claim
    raise UserError("every ROS domain from 1 to 101 is in use on this machine; choose one with ROS_DOMAIN_ID")


@contextmanager
def chosen_graph(environment: MutableMapping[str, str]) -> Iterator[None]:
    """Keep to this machine, and to a ROS domain that is unused there, unless the user chose otherwise.

    environment: the environment variables (updated).
    """
    limit_to_this_machine(environment)
    if "ROS_DOMAIN_ID" in environment:
        yield
        return
    domain, claim = claim_domain()
    with claim:
        environment["ROS_DOMAIN_ID"] = str(domain)
        yield
