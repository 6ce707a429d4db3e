"""Random rotations, the same over every SciPy: what Rotation.random takes was renamed."""

import numpy as np
from scipy.spatial.transform import Rotation


def random_turns(count: int, random: np.random.Generator) -> Rotation:
    """So many rotations, evenly spread."""
    return Rotation.from_quat(random.normal(size=(count, 4)))
