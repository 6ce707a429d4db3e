"""Hostile organ files: wrong in the zip, its arrays or their values; loaded, and simulated for some ticks."""

import io
import json
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from helpers.fuzz.child import Input, Ready
from helpers.fuzz.mutations import ODD_FLOATS, Draw, chance, mutation, odd_count, of_array, of_bytes, some
from helpers.fuzz.zips import bomb, members, of_zip, packed
from tissue_sim.bench.sweeps.trial_simulations import small_organ
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.organ_file import content_digest
from tissue_sim.organ.shipped import shipped_organ

TICKS = 20
PUSH = 0.1  # N

Arrays = dict[str, NDArray]


def prepare(path: Path) -> Ready:
    """Compile or load the kernels."""
    _use_intact()
    return lambda: _use(path)


@cache
def _use_intact() -> None:
    for name in ("small", "cells"):
        path = Path(tempfile.gettempdir()) / f"{name}.npz"
        path.write_bytes(_file(name))
        _use(path)


def _use(path: Path) -> str:
    organ = Organ.load(path)
    simulation = Simulation(organ)
    for tick in range(TICKS):
        simulation.apply_force([0], [[0.0, 0.0, PUSH]])
        simulation.step()
        assert np.all(np.isfinite(simulation.positions)), f"positions that are not finite after tick {tick + 1}"
    return f"{organ.n_nodes} nodes, {TICKS} ticks"


@st.composite
def organs(draw: Draw) -> Input:
    """Organ files with one or more mutations; most are small, as the errors of a large one are the same."""
    name = "cells" if chance(draw, 20) else "small"
    if draw(st.integers(0, 199)) == 199:
        data = bomb(draw, members(_arrays(name)))
    else:
        data = mutation(draw, (_bytes, _zip, _zip, _content, _content, _content))(draw, name)
    return Input({"organ.npz": data}, "organ.npz", prepare)


def _bytes(draw: Draw, name: str) -> bytes:
    return of_bytes(draw, _file(name))


def _zip(draw: Draw, name: str) -> bytes:
    return of_zip(draw, members(_arrays(name)))


def _content(draw: Draw, name: str) -> bytes:
    arrays = dict(_arrays(name))
    for _ in range(draw(st.integers(1, 2))):
        if chance(draw, 25):
            arrays["header"] = np.array(_header(draw, str(arrays["header"])))
        else:
            key = some(draw, [key for key in sorted(arrays) if key not in ("header", "sha256")])
            arrays[key] = of_array(draw, arrays[key])
    return packed(members(arrays if chance(draw, 5) else _sealed(arrays)))


_STRANGE = (None, "", "x" * 100_000, "a\nb\x1b[31m", [], {}, True, -1, 0, "4", 10**400, [[[]]])


def _header(draw: Draw, text: str) -> str:
    """A header with another value, or an invalid one."""
    if chance(draw, 20):
        return some(draw, ("", "null", "[]", "3", "{}", "[" * 100_000, '{"schema_version": 1e999}', "{" + text))
    try:
        header = dict(json.loads(text))
    except (ValueError, TypeError, RecursionError):
        return text  # already invalid
    if not header:
        return text
    key = some(draw, sorted(header))
    if key == "schema_version":
        header[key] = some(draw, (odd_count(draw, 4), *range(4), *_STRANGE))
    elif chance(draw, 40):
        header[key] = draw(ODD_FLOATS)
    elif chance(draw, 20):
        del header[key]
    else:
        header[key] = some(draw, _STRANGE)
    return json.dumps(header)


def _sealed(arrays: Arrays) -> Arrays:
    """Arrays with a matching checksum, so that their errors have to be found."""
    content = {name: array for name, array in arrays.items() if name not in ("header", "sha256")}
    text = str(arrays["header"])
    return {"header": arrays["header"], "sha256": np.array(content_digest(text, content)), **content}


@cache
def _file(name: str) -> bytes:
    if name == "cells":
        return shipped_organ().read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "organ.npz"
        small_organ().save(path)
        return path.read_bytes()


@cache
def _arrays(name: str) -> Arrays:
    with np.load(io.BytesIO(_file(name)), allow_pickle=False) as stored:
        return {key: stored[key] for key in stored.files}
