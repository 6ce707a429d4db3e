"""Reach of this process over DDS, and the profiles of Fast DDS that ship with the package."""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping

from tissue_sim.errors import UserError, shown
from tissue_sim.organ.shipped import shipped_file

REACH = "ROS_AUTOMATIC_DISCOVERY_RANGE"
ONLY_HERE, PEERS, SERVER = "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER"

DOMAIN = "ROS_DOMAIN_ID"
LAST_DOMAIN, LAST_OWN_DOMAIN = 232, 101  # last with ports (DDSI-RTPS 9.6.1); last below Linux's ephemeral ones

# Fast DDS 2 (Jazzy) reads the first, Fast DDS 3 the second.
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
CHOSEN_BY_HAND = "FASTDDS_BUILTIN_TRANSPORTS"  # the usual cure in containers; a profile with transports would undo it
# Discovery alone is no bound: a machine that names this one in its ROS_STATIC_PEERS is answered nevertheless. The
# second profile opens sockets on loopback only.
PROFILE, LOCAL_PROFILE = "config/fastdds.xml", "config/fastdds_local.xml"


def prepare(environment: MutableMapping[str, str] = os.environ) -> None:
    """Limit the reach to this machine and allow large organs, unless the user chose otherwise; before rclpy.init.

    environment: the environment variables (updated). Raises UserError for a domain that can't exist.
    """
    check_domain(environment)
    limit_to_this_machine(environment)
    use_shipped_profile(environment)


def check_domain(environment: Mapping[str, str] = os.environ) -> None:
    """Raise UserError for a ROS_DOMAIN_ID whose ports don't exist, or that is not a number."""
    given = environment.get(DOMAIN, "").strip()
    if given and not (given.isascii() and given.isdecimal() and int(given) <= LAST_DOMAIN):
        raise UserError(
            f"{DOMAIN} is '{shown(given)}'; expected: a number from 0 to {LAST_DOMAIN}, preferably up to"
            f" {LAST_OWN_DOMAIN}, above which Linux assigns the ports to other programs"
        )


def limit_to_this_machine(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set the discovery range to LOCALHOST, unless the user has set one of the variables for it.

    environment: the environment variables (updated).
    """
    if not any(environment.get(name) for name in (REACH, ONLY_HERE, PEERS, SERVER)):
        environment[REACH] = "LOCALHOST"


def is_local(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether no other machine is to be reached."""
    if environment.get(ONLY_HERE) == "1":
        return True  # in ROS it overrides the other two
    return environment.get(REACH) == "LOCALHOST" and not environment.get(PEERS) and not environment.get(SERVER)


def use_shipped_profile(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let Fast DDS carry large organs, and keep to loopback where that is meant.

    Not where the user has named a profile or transports; other middleware ignores it. An earlier choice here, for this
    process or its parent, is made again: the range may have changed.
    """
    ours = [str(path) for path in map(shipped_file, (PROFILE, LOCAL_PROFILE)) if path is not None]
    if any(environment.get(name, "") not in ("", *ours) for name in (*PROFILE_VARIABLES, CHOSEN_BY_HAND)):
        return
    profile = shipped_file(LOCAL_PROFILE if is_local(environment) else PROFILE)
    if profile is not None:
        environment.update(dict.fromkeys(PROFILE_VARIABLES, str(profile)))


def describe_discovery(environment: Mapping[str, str] = os.environ) -> str:
    """Return where a program with this environment is discoverable, for a log."""
    reach = environment.get(REACH) or "SUBNET"  # the default of ROS
    if is_local(environment):
        return f"discoverable on this machine only; {REACH}=SUBNET extends that to the subnet"
    if environment.get(SERVER):
        return f"discoverable through {SERVER}"
    places = {
        "LOCALHOST": "on this machine",
        "SUBNET": "in the whole subnet",
        "OFF": "by no other program",
        "SYSTEM_DEFAULT": "as the middleware is configured",
    }
    peers = f" and by {PEERS}" if environment.get(PEERS) and reach in ("LOCALHOST", "SUBNET") else ""
    return f"discoverable {places.get(reach, 'as set')}{peers} ({REACH}: {reach})"
