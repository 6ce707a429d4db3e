"""Hostile organ files: wrong in the zip, its arrays or their values; loaded, and simulated for some ticks."""

from __future__ import annotations

import io
import json
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue_sim.bench.fuzz.cases import Broken, Case, Input
from tissue_sim.bench.fuzz.files.mutations import Rng, odd_count, odd_float, of_array, of_bytes, some
from tissue_sim.bench.fuzz.files.zips import bomb, members, of_zip, packed
from tissue_sim.bench.sweeps.trial import small_organ
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ, content_digest
from tissue_sim.organ.shipped import shipped_organ

TICKS = 20
PUSH = 0.1  # N
_BOMBS = 0.005  # fraction of the cases


def prepare(case: Case, folder: Path) -> Input:
    """Make an organ file with one or more mutations."""
    rng, path = case.rng(), folder / "organ.npz"
    # Most are small, as the errors of a large one are the same.
    data, what = mutated(rng, some(rng, ("small", "small", "small", "small", "cells")))
    path.write_bytes(data)
    return Input(what, lambda: use(path))


def warm_up(folder: Path) -> None:
    """Compile or load the kernels."""
    for name in ("small", "cells"):
        path = folder / f"{name}.npz"
        path.write_bytes(_file(name))
        use(path)


def use(path: Path) -> str:
    """Load an organ, simulate it for some ticks, and check that everything stays finite."""
    organ = Organ.load(path)
    simulation = Simulation(organ)
    for tick in range(TICKS):
        simulation.apply_force([0], [[0.0, 0.0, PUSH]])
        simulation.step()
        if not np.all(np.isfinite(simulation.positions)):
            raise Broken(f"positions that are not finite after tick {tick + 1}")
    return f"{organ.n_nodes} nodes, {TICKS} ticks"


def mutated(rng: Rng, name: str) -> tuple[bytes, str]:
    """Return the bytes of an organ file with a mutation, and its description."""
    draw = rng.random()
    if draw < _BOMBS:
        return bomb(rng, members(_arrays(name)))
    if draw < 0.15:
        return of_bytes(rng, _file(name))
    if draw < 0.5:
        return of_zip(rng, members(_arrays(name)))
    arrays, told = dict(_arrays(name)), []
    for _ in range(int(rng.integers(1, 3))):
        told.append(_header(rng, arrays) if rng.random() < 0.25 else _values(rng, arrays))
    return _written(_sealed(arrays) if rng.random() < 0.95 else arrays), "; ".join(told)


def _values(rng: Rng, arrays: dict[str, NDArray[Any]]) -> str:
    name = some(rng, [name for name in sorted(arrays) if name not in ("header", "sha256")])
    arrays[name], told = of_array(rng, arrays[name])
    return f"{name} {told}"


def _header(rng: Rng, arrays: dict[str, NDArray[Any]]) -> str:
    """Change the header, or make it invalid."""
    try:
        header = dict(json.loads(str(arrays["header"])))
    except (ValueError, TypeError, RecursionError):
        header = {}  # already invalid
    if not header:
        return "header as it is"
    if rng.random() < 0.2:
        text = some(rng, ("", "null", "[]", "3", "{}", "[" * 100_000, '{"schema_version": 1e999}', "{" + str(header)))
        arrays["header"] = np.array(text)
        return f"header {text[:30]}"
    key = some(rng, sorted(header))
    strange: tuple[Any, ...] = (None, "", "x" * 100_000, "a\nb\x1b[31m", [], {}, True, -1, 0, "4", 10**400, [[[]]])
    if key == "schema_version":
        header[key] = some(rng, (odd_count(rng, 4), *range(4), *strange))
    elif rng.random() < 0.4:
        header[key] = odd_float(rng)
    elif rng.random() < 0.2:
        del header[key]
    else:
        header[key] = some(rng, strange)
    arrays["header"] = np.array(json.dumps(header))
    return f"header's {key} {str(header.get(key, 'left out'))[:30]!r}"


def _sealed(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return arrays with a matching checksum, so that their errors have to be found."""
    content = {name: array for name, array in arrays.items() if name not in ("header", "sha256")}
    text = str(arrays["header"])
    return {"header": arrays["header"], "sha256": np.array(content_digest(text, content)), **content}


def _written(arrays: dict[str, NDArray[Any]]) -> bytes:
    return packed(members(arrays))


@lru_cache(maxsize=2)
def _file(name: str) -> bytes:
    if name == "cells":
        return shipped_organ().read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "organ.npz"
        small_organ().save(path)
        return path.read_bytes()


@lru_cache(maxsize=2)
def _arrays(name: str) -> dict[str, NDArray[Any]]:
    with np.load(io.BytesIO(_file(name)), allow_pickle=False) as stored:
        return {key: stored[key] for key in stored.files}
