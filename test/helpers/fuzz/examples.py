"""How many examples the tests of test/fuzz draw, and from which seed.

FUZZ_EXAMPLES is their number, FUZZ_SEED their seed: `make fuzz` sets both. Without a seed the examples follow from the
code of the test, so that they are the same in every run.
"""

import contextlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.internal.conjecture.engine import ConjectureRunner

# The checkout stays as it is.
set_hypothesis_home_dir(Path(tempfile.gettempdir()) / f"tissue_sim_hypothesis_{os.getuid()}")
# Hypothesis would also draw the numbers that stand in the sources of this package, as far as they are loaded: examples
# would depend on which tests have run before. Older versions don't.
with contextlib.suppress(ImportError):
    from hypothesis.internal.conjecture import providers

    providers._get_local_constants = lambda: providers._local_constants
# And it would vary every example five times by copying parts of it to others: meshes were refused for half as many
# different reasons.
ConjectureRunner.generate_mutations_from = lambda runner, data: None
settings.register_profile(
    "repeatable",
    database=None,
    derandomize=True,
    deadline=None,
    phases=(Phase.explicit, Phase.generate, Phase.shrink),
    suppress_health_check=list(HealthCheck),  # some of which measure time
)


def examples(few: int, shrink: bool = True) -> Callable:
    """Decorator of a test that draws: `few` examples, or what the environment says; whether failures are simplified."""
    count = int(os.environ.get("FUZZ_EXAMPLES") or few)
    chosen = settings(settings.get_profile("repeatable"), max_examples=count)
    if not shrink:
        chosen = settings(chosen, phases=(Phase.explicit, Phase.generate))
    drawn_from = os.environ.get("FUZZ_SEED")
    return lambda test: seed(int(drawn_from))(chosen(test)) if drawn_from else chosen(test)
