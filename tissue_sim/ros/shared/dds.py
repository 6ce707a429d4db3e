"""The DDS profile that ships with the package."""

from __future__ import annotations

import os
from collections.abc import MutableMapping

from tissue_sim.organ.shipped import shipped_file

# Fast DDS 2 (Jazzy) reads the first, Fast DDS 3 the second.
PROFILE_VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")


CHOSEN_BY_HAND = "FASTDDS_BUILTIN_TRANSPORTS"  # the usual cure in containers; a profile with transports would undo it


def use_shipped_profile(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let Fast DDS carry large organs: before rclpy.init, unless the user has named a profile or transports.

    Other middleware ignores it.
    """
    if any(environment.get(name) for name in (*PROFILE_VARIABLES, CHOSEN_BY_HAND)):
        return
    profile = shipped_file("config/fastdds.xml")
    if profile is not None:
        environment.update(dict.fromkeys(PROFILE_VARIABLES, str(profile)))
