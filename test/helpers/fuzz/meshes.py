"""Hostile meshes of every format: wrong counts, invalid numbers, parts cut off, names of other files."""

import json
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st

from helpers.fuzz import mesh_files as files
from helpers.fuzz.child import OUTSIDE, Input, Ready
from helpers.fuzz.mutations import HUGE, ODD_FLOATS, Draw, chance, odd_count, of_bytes, of_text, some
from tissue_sim.organ.meshes.mesh_input import read_mesh, voxelize
from tissue_sim.organ.surface_checks import check_surface

LENGTH = 0.1  # m, stated longest side of an organ
_AXIS = 24  # voxels along the longest side: as a mesh is used, in less time


def prepare(path: Path, in_mm: bool, merge_parts: bool) -> Ready:
    """Read one of each format, intact."""
    _use_intact()
    return lambda: _use(path, in_mm, merge_parts)


@cache
def _use_intact() -> None:
    for form in FORMS:
        path = Path(tempfile.gettempdir()) / f"mesh{form.suffix}"
        path.write_bytes(form.write())
        _use(path)


def _use(path: Path, in_mm: bool = False, merge_parts: bool = False) -> str:
    """Read and repair a surface, make voxels of it, and check that it is closed and finite."""
    mesh = read_mesh(path, **{"unit": "mm"} if in_mm else {"longest": LENGTH}, merge_parts=merge_parts)
    assert np.all(np.isfinite(mesh.positions)), "points that are not finite"
    used, inverse = np.unique(mesh.triangles, return_inverse=True)
    check_surface(mesh.positions[used], inverse.reshape(-1, 3).astype(np.int32), "the surface that was read")
    solid = voxelize(mesh, str(path), _AXIS)
    return f"{len(mesh.positions)} points, {np.count_nonzero(solid.array)} voxels"


class Form(NamedTuple):
    """Format: what writes an intact file, and what makes its head contradict its content."""

    name: str
    suffix: str
    write: Callable[[], bytes]
    falsify: Callable[[Draw, bytes], bytes]


@st.composite
def meshes(draw: Draw) -> Input:
    """Mesh files with a mutation, or in the name of another format."""
    form: Form = some(draw, FORMS)
    chosen = draw(st.integers(0, 99))
    if chosen < 45:
        data = of_bytes(draw, form.write())
    elif chosen < 90 or form.suffix == ".glb":
        data = form.falsify(draw, form.write())
    else:
        data = some(draw, FORMS).write()
    name = f"mesh{form.suffix}"
    return Input({name: data}, name, prepare, (chance(draw, 30), chance(draw, 15)))


def _stl(draw: Draw, data: bytes) -> bytes:
    made = bytearray(data)
    if chance(draw, 50):
        struct.pack_into("<I", made, 80, odd_count(draw, struct.unpack_from("<I", data, 80)[0]) % 2**32)
        return bytes(made)
    for _ in range(draw(st.integers(1, 4))):
        at = 84 + 50 * draw(st.integers(0, (len(made) - 84) // 50 - 1)) + 4 * draw(st.integers(0, 11))
        with np.errstate(all="ignore"):
            made[at : at + 4] = np.float32(draw(ODD_FLOATS)).tobytes()
    return bytes(made)


def _ply(draw: Draw, data: bytes) -> bytes:
    end = data.index(b"end_header")
    head, rest = data[:end], data[end:]
    if chance(draw, 60):
        return of_text(draw, head) + rest
    count = str(some(draw, HUGE)).encode()
    replacements = (
        (b"vertex 162", b"vertex " + count),
        (b"face 320", b"face " + count),
        (b"uchar int", some(draw, (b"float float", b"int double", b"char uchar", b"double int"))),
        (b"float x", some(draw, (b"uchar x", b"list uchar float x", b"string x", b"double x"))),
        (b"little_endian", b"big_endian"),
        (b"element face", b"comment"),
    )
    return head.replace(*some(draw, replacements), 1) + rest


_OBJ_LINES = (
    f"mtllib ../{OUTSIDE}",
    "mtllib /etc/passwd\nusemtl x",
    f"mtllib ../{OUTSIDE}\nusemtl a\nf 1 2 3",
    f"call ../{OUTSIDE}",
    "f 0 0 0",
    "f -1 -2 -3",
    "f 1 2 99999999999999999999",
    "f 1//1 2//2 3//3",
    "f 1/2/3/4 2 3",
    "f 1 2",
    "f " + " ".join(["1"] * 20_000),
    "v 1 2",
    "v nan nan nan",
    "o " + "x" * 10_000,
    "g a\ng b\nf 1 2 3",
)


def _obj(draw: Draw, data: bytes) -> bytes:
    if chance(draw, 60):
        return of_text(draw, data)
    lines = data.split(b"\n")
    lines.insert(draw(st.integers(0, len(lines))), some(draw, _OBJ_LINES).encode())
    return b"\n".join(lines)


def _places(node: object) -> list[tuple[Any, Any]]:
    """All of a tree that can be changed: a part, and the key or index in it."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [place for key, value in items for place in ((node, key), *_places(value))]


_URIS = (f"../{OUTSIDE}", "/etc/passwd", "file:///etc/passwd", "http://127.0.0.1:9/x", "data:;base64,AAAA", "")


def _change_tree(draw: Draw, tree: dict) -> None:
    """Change a number, a name or an entry of the tree."""
    chosen = draw(st.integers(0, 99))
    if chosen < 65:
        node, key = some(draw, _places(tree))
        if chance(draw, 20):
            del node[key]
        elif isinstance(node[key], int):
            node[key] = odd_count(draw, node[key])
        else:
            node[key] = some(draw, (None, -1, 1e300, [], {}, "x", [0], 10**9))
    elif chosen < 80:
        tree["buffers"][0]["uri"] = some(draw, _URIS)
    elif chosen < 90:
        tree["images"], tree["textures"] = [{"uri": f"../{OUTSIDE}"}], [{"source": 0}]
        tree["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
        tree["meshes"][0]["primitives"][0]["material"] = 0
    else:
        tree["nodes"][0]["children"] = [0]  # a node in itself


def _glb(draw: Draw, data: bytes) -> bytes:
    size = struct.unpack_from("<I", data, 12)[0]
    tree, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    _change_tree(draw, tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    length = 20 + len(text) + len(rest)
    if chance(draw, 15):
        length = odd_count(draw, length) % 2**32
    return struct.pack("<4sIIII", b"glTF", 2, length, len(text), 0x4E4F534A) + text + rest


def _gltf(draw: Draw, data: bytes) -> bytes:
    tree = json.loads(data)
    _change_tree(draw, tree)
    return json.dumps(tree).encode()


def _vtk_head(draw: Draw, data: bytes) -> bytes:
    """Change a count of a binary file, whose heads lie between numbers."""
    at = data.index(some(draw, (b"POINTS", b"POLYGONS")))
    end = data.index(b"\n", at)
    words = data[at:end].split(b" ")
    k = draw(st.integers(1, len(words) - 1))
    number = words[k].isdigit()
    words[k] = str(odd_count(draw, 162)).encode() if number else some(draw, (b"int", b"char", b"long", b"x"))
    return data[:at] + b" ".join(words) + data[end:]


FORMS = (
    Form("STL", ".stl", files.exported("stl"), _stl),
    Form("STL as text", ".stl", files.exported("stl_ascii"), of_text),
    Form("PLY", ".ply", files.exported("ply"), _ply),
    Form("PLY as text", ".ply", files.exported("ply", encoding="ascii"), _ply),
    Form("OFF", ".off", files.exported("off"), of_text),
    Form("OBJ", ".obj", files.exported("obj"), _obj),
    Form("GLB", ".glb", files.exported("glb"), _glb),
    Form("glTF", ".gltf", files.gltf, _gltf),
    Form("VTK", ".vtk", files.vtk_text, of_text),
    Form("VTK, binary", ".vtk", files.vtk_binary, _vtk_head),
    Form("VTK 5.1", ".vtk", files.vtk_5, of_text),
    Form("VTK XML", ".vtp", files.vtp, of_text),
    Form("VTK XML, binary", ".vtu", files.vtu, of_text),
    Form("Gmsh 1", ".msh", files.gmsh_1, of_text),
    Form("Gmsh 2.2", ".msh", files.gmsh_2, of_text),
    Form("Gmsh 4.1", ".msh", files.gmsh_4, of_text),
    Form(".trian", ".trian", files.trian, of_text),
)
