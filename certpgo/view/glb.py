"""Meshes as binary glTF, which browsers draw with a colour at each point."""

from __future__ import annotations

import json
import struct

import numpy as np
from numpy.typing import NDArray

from certpgo.linalg.arrays import FloatArray, IntArray

_FLOATS, _BYTES, _INTEGERS = 5126, 5121, 5125
_POINTS, _FACES = 34962, 34963


def glb(points: FloatArray, colours: NDArray[np.uint8], faces: IntArray) -> bytes:
    """A mesh of points (p, 3) with colours (p, 3) and triangles (f, 3), seen from both sides."""
    opaque = np.full((len(points), 1), 255, dtype=np.uint8)
    blobs = [
        points.astype("<f4").tobytes(),
        np.hstack([colours, opaque]).tobytes(),
        faces.astype("<u4").tobytes(),
    ]
    starts = np.cumsum([0, *map(len, blobs)]).tolist()
    targets = (_POINTS, _POINTS, _FACES)
    low, high = points.astype("<f4").min(axis=0), points.astype("<f4").max(axis=0)
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {"attributes": {"POSITION": 0, "COLOR_0": 1}, "indices": 2, "material": 0}
                ]
            }
        ],
        "materials": [
            {
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            }
        ],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(blob), "target": target}
            for start, blob, target in zip(starts, blobs, targets, strict=False)
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": _FLOATS,
                "count": len(points),
                "type": "VEC3",
                "min": low.tolist(),
                "max": high.tolist(),
            },
            {
                "bufferView": 1,
                "componentType": _BYTES,
                "normalized": True,
                "count": len(points),
                "type": "VEC4",
            },
            {
                "bufferView": 2,
                "componentType": _INTEGERS,
                "count": faces.size,
                "type": "SCALAR",
            },
        ],
    }
    header = json.dumps(content).encode()
    header += b" " * (-len(header) % 4)
    body = b"".join(blobs)
    total = 12 + 8 + len(header) + 8 + len(body)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, total),
            struct.pack("<I4s", len(header), b"JSON"),
            header,
            struct.pack("<I4s", len(body), b"BIN\0"),
            body,
        ]
    )
