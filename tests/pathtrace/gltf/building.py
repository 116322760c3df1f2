"""glTF files made by hand: JSON, and one buffer in base64 or in a binary chunk."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

_KINDS = {"float32": 5126, "uint8": 5121, "uint16": 5123, "uint32": 5125, "int16": 5122}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Building:
    """A glTF file that grows; `tree` is its JSON and may be changed freely."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}}
        self.content = b""

    def add(self, section: str, **item: Any) -> int:
        """Adds a node, mesh, material or the like; its number."""
        items = self.tree.setdefault(section, [])
        items.append(item)
        return len(items) - 1

    def view(self, content: bytes, **more: Any) -> int:
        """Adds bytes to the buffer."""
        self.content += b"\0" * (-len(self.content) % 4)
        start = len(self.content)
        self.content += content
        return self.add("bufferViews", buffer=0, byteOffset=start, byteLength=len(content), **more)

    def array(self, values: Any, kind: str = "float32", **more: Any) -> int:
        """Adds an accessor of (N,) or (N, columns) numbers."""
        found = np.asarray(values, dtype=kind)
        found = found.reshape(len(found), -1)
        extremes = {"min": found.min(axis=0).tolist(), "max": found.max(axis=0).tolist()}
        return self.add(
            "accessors",
            bufferView=self.view(found.tobytes()),
            componentType=_KINDS[kind],
            count=len(found),
            type=_TYPES[found.shape[1]],
            **extremes,
            **more,
        )

    def mesh(self, vertices: Any, faces: Any, targets: Any = (), **more: Any) -> int:
        """Adds a mesh of one primitive; further attributes are accessors, `material` and `mode` numbers."""
        attributes = {key: value for key, value in more.items() if key.isupper() or key[-1].isdigit()}
        part = {key: value for key, value in more.items() if key in ("material", "mode")}
        part["attributes"] = {"POSITION": self.array(vertices), **attributes}
        part["indices"] = self.array(np.ravel(faces), "uint16")
        if len(targets):
            part["targets"] = [{"POSITION": self.array(target)} for target in targets]
        mesh = {"weights": more["weights"]} if "weights" in more else {}
        return self.add("meshes", primitives=[part], **mesh)

    def node(self, **item: Any) -> int:
        """Adds a node, to the scene as well unless it is somebody's child."""
        return self.add("nodes", **item)

    def animation(self, *channels: tuple[int, str, Any, Any, str], **item: Any) -> int:
        """Adds an animation of channels: node, path, times, values, interpolation."""
        samplers = [
            {"input": self.array(times), "output": self.array(values), "interpolation": kind}
            for _, _, times, values, kind in channels
        ]
        targets = [
            {"sampler": number, "target": {"node": node, "path": path}}
            for number, (node, path, *_) in enumerate(channels)
        ]
        return self.add("animations", channels=targets, samplers=samplers, **item)

    def save(self, file: Path) -> Path:
        """Writes .gltf or .glb."""
        tree = {**self.tree, "buffers": [{"byteLength": len(self.content)}]}
        if file.suffix == ".gltf":
            data = base64.b64encode(self.content).decode()
            tree["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
            file.write_text(json.dumps(tree))
            return file
        text = json.dumps(tree).encode()
        text += b" " * (-len(text) % 4)
        binary = self.content + b"\0" * (-len(self.content) % 4)
        length = 12 + 8 + len(text) + 8 + len(binary)
        head = struct.pack("<4sII", b"glTF", 2, length)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        file.write_bytes(head + chunks)
        return file


BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
BOX_FACES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
QUAD_FACES = [[0, 1, 2], [0, 2, 3]]


def tube(rings: int = 9, around: int = 8) -> tuple[np.ndarray, list[list[int]], np.ndarray]:
    """A tube of height 2 and radius 0.25 along y: vertices, faces, and how far up vertices are, 0 to 1."""
    turn = np.linspace(0, 2 * np.pi, around, endpoint=False)
    up = np.repeat(np.linspace(0, 1, rings), around)
    circle = np.tile(np.stack([0.25 * np.cos(turn), 0.25 * np.sin(turn)], axis=1), (rings, 1))
    vertices = np.stack([circle[:, 0], 2 * up, circle[:, 1]], axis=1)
    faces = []
    for ring in range(rings - 1):
        for a in range(around):
            b, low, high = (a + 1) % around, ring * around, (ring + 1) * around
            faces += [[low + a, high + a, low + b], [low + b, high + a, high + b]]
    return vertices, faces, up


def quaternion(axis: tuple[float, float, float], degrees: float) -> list[float]:
    """(x, y, z, w)."""
    half = np.radians(degrees) / 2
    unit = np.array(axis) / np.linalg.norm(axis)
    return [*(np.sin(half) * unit).tolist(), float(np.cos(half))]


def bending_tube(building: Building) -> int:
    """A skinned tube whose upper half bends by 90 degrees around z within a second; the joint's node."""
    vertices, faces, up = tube()
    joints = np.tile([0, 1, 0, 0], (len(up), 1))
    weights = np.stack([1 - up, up, 0 * up, 0 * up], axis=1)
    upper = building.node(translation=[0, 1, 0])
    lower = building.node(children=[upper])
    inverse = np.tile(np.eye(4), (2, 1, 1))
    inverse[1, 1, 3] = -1
    skin = building.add(
        "skins",
        joints=[lower, upper],
        inverseBindMatrices=building.array(inverse.transpose(0, 2, 1).reshape(2, 16)),
    )
    mesh = building.mesh(
        vertices,
        faces,
        JOINTS_0=building.array(joints, "uint8"),
        WEIGHTS_0=building.array(weights),
    )
    # That of the node itself must not count.
    building.node(mesh=mesh, skin=skin, translation=[9, 9, 9], name="tube")
    turns = [quaternion((0, 0, 1), angle) for angle in (0, 90)]
    building.animation((upper, "rotation", [0, 1], turns, "LINEAR"), name="bend")
    return upper
