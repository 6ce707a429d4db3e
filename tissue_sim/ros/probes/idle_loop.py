"""Probe `python -m tissue_sim.ros.probes.idle_loop RATE`: a bare loop that wakes RATE times a second."""

from __future__ import annotations

import sys
import time

from tissue_sim.unexpected_errors import catch_all


def main(rate: str) -> None:
    """Run until it is ended by a signal."""
    while True:
        time.sleep(1.0 / float(rate))


if __name__ == "__main__":
    catch_all("sleeper")
    try:
        main(sys.argv[1])
    except KeyboardInterrupt:
        sys.exit(0)
