"""The program `tissue_node`: signals are heard before what takes a second to load is loaded."""

from __future__ import annotations

import os
import sys
from typing import NoReturn

from tissue_sim.ros.shared.ending import Ending, Interrupted


def run() -> NoReturn:
    """Run the node and leave the process."""
    code, ending = 0, None
    try:
        ending = Ending()  # from here on, and within, a signal raises Interrupted

        from tissue_sim.ros.node.serve import serve

        code = serve(sys.argv, ending)
    except Interrupted:
        pass
    except Exception:
        # A library that was being loaded may have turned Interrupted into an error of its own.
        if ending is None or not ending.asked.is_set():
            raise
    sys.stdout.flush()
    os._exit(code)  # the wheels' DDS threads may outlive the interpreter otherwise


if __name__ == "__main__":
    run()
