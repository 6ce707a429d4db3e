"""Entry point of `python -m tissue_sim COMMAND`, where the program isn't on the path."""

import sys

from tissue_sim.cli import main

sys.exit(main())
