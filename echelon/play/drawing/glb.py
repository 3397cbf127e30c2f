"""Meshes with colours at their points as binary glTF 2.0, the one form of mesh that viser gives vertex colours.

Only what the page needs: positions, colours, texture coordinates; three.js works out normals itself. Colours may be
brighter than 1: they are stored as parts of the brightest, which is the material's base colour.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_FLOAT, _SHORT, _INT = 5126, 5123, 5125
_POINTS, _TRIANGLES = 34962, 34963


@dataclass(frozen=True)
class ColoredMesh:
    """Triangles.

    Attributes:
        points: [m], shape [n, 3].
        triangles: Counter-clockwise seen from where they are visible, shape [m, 3].
        colors: Linear RGB, not below 0, and opacity from 0 to 1, shape [n, 4].
        uv: Texture coordinates, shape [n, 2]; None where there is no texture.
    """

    points: np.ndarray
    triangles: np.ndarray
    colors: np.ndarray
    uv: np.ndarray | None = None


def glb(
    meshes: Sequence[ColoredMesh], *, shaded: bool, see_through: bool = False, texture: bytes | None = None
) -> bytes:
    """A binary glTF of some meshes, each of which is left out by itself where it is out of sight.

    Args:
        meshes: At least one, none of them empty.
        shaded: Whether light falls on them; otherwise their colours are shown as they are.
        see_through: Whether opacity counts.
        texture: A picture, PNG, that repeats itself and multiplies the colours; needs `ColoredMesh.uv`.
    """
    buffer = _Buffer()
    brightest = max(1.0, *(float(mesh.colors[:, :3].max()) for mesh in meshes))
    primitives = [_mesh(buffer, mesh, brightest) for mesh in meshes]
    pbr: dict[str, Any] = {
        "baseColorFactor": [brightest, brightest, brightest, 1.0],
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    material: dict[str, Any] = {"pbrMetallicRoughness": pbr, "alphaMode": "BLEND" if see_through else "OPAQUE"}
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(primitives)))}],
        "nodes": [{"mesh": index} for index in range(len(primitives))],
        "meshes": [{"primitives": [primitive]} for primitive in primitives],
        "materials": [material],
    }
    if not shaded:
        material["extensions"] = {"KHR_materials_unlit": {}}
        document["extensionsUsed"] = ["KHR_materials_unlit"]
    if texture is not None:
        document["images"] = [{"bufferView": buffer.view(texture), "mimeType": "image/png"}]
        # Bilinear, the nearest mipmap: three.js in software spends most of its time on textures.
        document["samplers"] = [{"magFilter": 9729, "minFilter": 9985, "wrapS": 10497, "wrapT": 10497}]
        document["textures"] = [{"source": 0, "sampler": 0}]
        pbr["baseColorTexture"] = {"index": 0}
    data = buffer.data()
    document |= {"accessors": buffer.accessors, "bufferViews": buffer.views, "buffers": [{"byteLength": len(data)}]}
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = [(len(text), b"JSON", text), (len(data), b"BIN\0", data)]
    body = b"".join(size.to_bytes(4, "little") + kind + content for size, kind, content in chunks)
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body


class _Buffer:
    """Bytes that are put together, and what says where in them is what."""

    def __init__(self) -> None:
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self._parts: list[bytes] = []
        self._length = 0

    def view(self, content: bytes, target: int | None = None) -> int:
        entry = {"buffer": 0, "byteOffset": self._length, "byteLength": len(content)}
        self.views.append(entry if target is None else entry | {"target": target})
        padded = content + b"\0" * (-len(content) % 4)
        self._parts.append(padded)
        self._length += len(padded)
        return len(self.views) - 1

    def accessor(self, values: np.ndarray, component: int, kind: str, target: int, **more: Any) -> int:
        entry = {"bufferView": self.view(np.ascontiguousarray(values).tobytes(), target), "componentType": component}
        self.accessors.append({**entry, "count": len(values), "type": kind, **more})
        return len(self.accessors) - 1

    def data(self) -> bytes:
        return b"".join(self._parts)


def _mesh(buffer: _Buffer, mesh: ColoredMesh, brightest: float) -> dict[str, Any]:
    points = np.asarray(mesh.points, dtype="<f4")
    parts = np.asarray(mesh.colors, dtype=np.float64) / [brightest, brightest, brightest, 1.0]
    colors = np.round(np.clip(parts, 0.0, 1.0) * 65535.0).astype("<u2")
    corners = np.asarray(mesh.triangles).reshape(-1)
    small = len(points) <= 65535
    attributes = {
        "POSITION": buffer.accessor(
            points, _FLOAT, "VEC3", _POINTS, min=points.min(axis=0).tolist(), max=points.max(axis=0).tolist()
        ),
        "COLOR_0": buffer.accessor(colors, _SHORT, "VEC4", _POINTS, normalized=True),
    }
    if mesh.uv is not None:
        attributes["TEXCOORD_0"] = buffer.accessor(np.asarray(mesh.uv, dtype="<f4"), _FLOAT, "VEC2", _POINTS)
    indices = buffer.accessor(
        corners.astype("<u2" if small else "<u4"), _SHORT if small else _INT, "SCALAR", _TRIANGLES
    )
    return {"attributes": attributes, "indices": indices, "material": 0}
