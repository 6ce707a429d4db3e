"""The organs that are compared at one size: as the pipeline makes it, and calibrated in both ways."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from tissue_sim.bench.sizes import at_size
from tissue_sim.calibration.calibrate import Settings, calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.store import remembered

# Beyond what is asked for at the organ's own size a calibration may take minutes, not tens of them: fewer cases, and
# none that are settled nonlinearly on many points.
FEW_POINTS = 1000
CASES, FEW_CASES, NONLINEAR, STEPS = 400, 200, 16, 40


class Variants(NamedTuple):
    """The organs of one size: as the pipeline makes it, calibrated by the few groups, and spring by spring.

    In place of one that is missing, the reason.
    """

    plain: Organ
    groups: Organ | str
    springs: Organ | str


def variants_of(organ: Organ, points: int, *, fit: bool) -> Variants:
    """The organs of one size of an organ's body.

    fit: calibrate those that are not, which takes minutes each; they are kept in the user's cache. Without it only
    an organ that is itself calibrated has a calibrated variant.
    """
    plain = at_size(organ, points)
    own = points == organ.n_surface and _method(organ) == "springs"
    left_out = "takes minutes to fit and is left out of --quick"
    missing = "the organ is not calibrated: 'tissue_sim calibrate ORGAN --out ORGAN2'"
    if not fit:
        return Variants(plain, left_out, organ if own else missing)
    return Variants(plain, _calibrated(plain, "groups"), organ if own else _calibrated(plain, "springs"))


def _method(organ: Organ) -> str | None:
    """How an organ was calibrated: springs, groups, or None."""
    figures = organ.provenance.get("calibration")
    return figures.get("method") if isinstance(figures, dict) else None


def _settings(points: int, method: str) -> Settings:
    few = points <= FEW_POINTS
    return Settings(
        method=method,
        cases=CASES if few else FEW_CASES,
        nonlinear=NONLINEAR if few and method == "springs" else 0,
        steps=STEPS,
        smooth=1,  # what it is judged by is measured here, beside all others
        sharp=0,
    )


def _calibrated(plain: Organ, method: str) -> Organ | str:
    """The organ calibrated, from the user's cache when it was done before; the reason when it can't be."""
    settings = _settings(plain.n_surface, method)
    key = f"{json.dumps(dataclasses.asdict(settings), sort_keys=True)} {plain.digest()}"

    def make() -> dict[str, NDArray]:
        return packed(calibrate(plain, settings, Checkpoint(None, {}), _Bars()).organ)

    try:
        return unpacked(remembered(f"calibrated-{method}", hashlib.sha256(key.encode()).hexdigest(), make))
    except UserError as error:
        return str(error)


def packed(organ: Organ) -> dict[str, NDArray]:
    """All of an organ as arrays."""
    arrays = {name: getattr(organ, name) for name in _arrays()}
    rest = {name: getattr(organ, name) for name in ("name", "youngs_modulus", "poisson_ratio", "density")}
    return arrays | {"rest": np.array(json.dumps(rest | {"provenance": dict(organ.provenance)}))}


def unpacked(arrays: dict[str, NDArray]) -> Organ:
    """The organ of its arrays."""
    return Organ(**json.loads(str(arrays["rest"])), **{name: arrays[name] for name in _arrays()})


def _arrays() -> list[str]:
    return [field.name for field in dataclasses.fields(Organ) if "dtype" in field.metadata]


class _Bars:
    """A bar for every stage of a calibration."""

    @contextmanager
    def stage(self, name: str, total: int) -> Iterator[Callable[..., None]]:
        """A bar that is gone when the stage is done."""
        with tqdm(total=total, desc=name, leave=False) as bar:

            def done(remark: str = "") -> None:
                bar.set_postfix_str(remark, refresh=False)
                bar.update()

            yield done
