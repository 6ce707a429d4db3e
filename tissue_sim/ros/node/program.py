"""The program `tissue_node`: signals are handled before the slow imports begin."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import NoReturn

from tissue_sim.ros.shared.shutdown_handler import Interrupted, ShutdownHandler
from tissue_sim.unexpected_errors import catch_all, report_error


def run() -> NoReturn:
    """Run the node and leave the process."""
    code, ending = 0, None
    catch_all("tissue_node")
    try:
        ending = ShutdownHandler()  # from here on, and within, a signal raises Interrupted

        from tissue_sim.ros.node.serve import serve

        code = serve(sys.argv, ending)
    except Interrupted:
        pass
    except Exception as error:
        # A library that was being loaded may have turned Interrupted into an error of its own.
        if ending is None or not ending.interrupted:
            report_error(error, "tissue_node")
            code = 1
    with suppress(OSError):  # full or gone
        sys.stdout.flush()
    os._exit(code)  # the wheels' DDS threads may outlive the interpreter otherwise


if __name__ == "__main__":
    run()
