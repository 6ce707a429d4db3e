"""A surface with a colour at each vertex as the bytes of a GLB (glTF 2.0), written in place.

Meshes of viser have one colour; with a GLB it draws more. Exporters create a new one each time, and store colours as
eight bits of linear light, too few for dark ones.
"""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.json_types import JsonObject

FLOAT, UNSIGNED, ARRAY, INDICES = 5126, 5125, 34962, 34963  # glTF's codes for types of numbers and of buffers
ROUGHNESS = 0.5  # of a moist surface


class ColouredSurface:
    """A surface that is drawn repeatedly.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Its approximate positions.
    triangles : Ints | Longs, shape (t, 3)
        Its triangles.
    opacity : float, optional
        1 hides what is within.
    """

    def __init__(self, rest: Floats, triangles: Ints | Longs, opacity: float = 1.0) -> None:
        faces = np.ascontiguousarray(triangles, dtype="<u4")
        self._triangles = triangles
        t, n = len(triangles), len(rest)
        corners = triangles.ravel(), np.repeat(np.arange(t), 3)
        self._around = csr_array((np.ones(3 * t), corners), shape=(n, t))  # triangles around each node
        parts = [12 * n, 12 * n, 12 * n, faces.nbytes]
        text = json.dumps(_described(rest, t, parts, opacity)).encode()
        text += b" " * (-len(text) % 4)
        body = sum(parts)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + body)
        head += struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", body, b"BIN\0")
        self._bytes = bytearray(head + bytes(body))
        self._is_translucent = opacity < 1.0
        self._faces = np.frombuffer(memoryview(self._bytes)[-faces.nbytes :], dtype="<u4").reshape(t, 3)
        self._faces[:] = faces
        numbers = memoryview(self._bytes)[len(head) : len(head) + 36 * n]
        self._positions, self._normals, self._colours = np.frombuffer(numbers, dtype="<f4").reshape(3, n, 3)

    def message(self, positions: Floats, colours: Floats, eye: Floats | None = None) -> bytes:
        """Return the bytes of a surface.

        Parameters
        ----------
        positions : Floats, shape (n, 3), m
            Its positions.
        colours : Floats, shape (n, 3)
            Red, green, blue as light of 0 to 1.
        eye : Floats | None, shape (3,), m, optional
            Viewpoint; triangles of a translucent surface are drawn from the farthest to the nearest, or the visible
            parts of a fold would depend on the mesh.
        """
        corners = positions[self._triangles]
        if self._is_translucent and eye is not None:
            away = np.linalg.norm(corners.mean(axis=1) - eye, axis=1)
            self._faces[:] = self._triangles[np.argsort(-away, kind="stable")]
        outward = self._around @ np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(outward, axis=1, keepdims=True)
        self._normals[:] = outward / np.where(length > 0.0, length, 1.0)
        self._positions[:], self._colours[:] = positions, colours
        return bytes(self._bytes)


def light_of(colours: ArrayLike) -> Floats:
    """Return colours of screens (sRGB, IEC 61966-2-1), 0 to 255, as light of 0 to 1.

    Parameters
    ----------
    colours : ArrayLike, shape (..., 3)
        The colours.
    """
    fraction = np.asarray(colours, dtype=np.float64) / 255.0
    return np.asarray(np.where(fraction <= 0.04045, fraction / 12.92, ((fraction + 0.055) / 1.055) ** 2.4))


def _described(rest: Floats, n_faces: int, parts: list[int], opacity: float) -> JsonObject:
    """Return the description of the numbers in glTF."""
    n = len(rest)
    starts = np.cumsum([0, *parts]).tolist()
    targets = (ARRAY, ARRAY, ARRAY, INDICES)
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    low, high = (part.astype(np.float32).astype(float).tolist() for part in (rest.min(axis=0), rest.max(axis=0)))
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [
            {
                "pbrMetallicRoughness": {
                    "baseColorFactor": [1.0, 1.0, 1.0, opacity],
                    "metallicFactor": 0.0,
                    "roughnessFactor": ROUGHNESS,
                },
                "alphaMode": "OPAQUE" if opacity >= 1.0 else "BLEND",
            }
        ],
        "accessors": [
            {"bufferView": 0, "componentType": FLOAT, "count": n, "type": "VEC3", "min": low, "max": high},
            {"bufferView": 1, "componentType": FLOAT, "count": n, "type": "VEC3"},
            {"bufferView": 2, "componentType": FLOAT, "count": n, "type": "VEC3"},
            {"bufferView": 3, "componentType": UNSIGNED, "count": 3 * n_faces, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": size, "target": target}
            for start, size, target in zip(starts, parts, targets, strict=False)
        ],
        "buffers": [{"byteLength": sum(parts)}],
    }
