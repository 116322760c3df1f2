"""Gaussians from and to glTF (KHR_gaussian_splatting): transforms of nodes, colour spaces, GLB files.

What the extension calls the colour space is what Gaussians are blended in: `srgb_rec709_display` by the
rules of 3D Gaussian splatting, `lin_rec709_display` in linear radiance, and harmonics are of that, too. Those
of this project are always of perceptual radiance; each is converted by fitting harmonics of its degree
to the other curve, which is exact where nothing depends on direction.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.base.files import write_whole
from compose.camera.camera import sphere_directions
from splat.model.gaussians import Blending, Gaussians, perceptual_from_radiance, radiance_from_perceptual
from splat.model.points import Floats, quaternions_xyzw, rows_of
from splat.raster.projection import sh_basis

EXTENSION = "KHR_gaussian_splatting"
_COLOUR_SPACES = {Blending.DISPLAY: "srgb_rec709_display", Blending.LINEAR: "lin_rec709_display"}
_FLOAT, _POINTS, _VERTICES = 5126, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_MOST_BYTES = (1 << 32) - (1 << 16)
# Logits of what is opaque, or invisible.
_OPAQUE = 20.0
_LEAST_SCALE = 1e-20
# By how much a node may shear, and its axes differ in length and still be one length.
_SHEAR, _EQUAL = 1e-3, 1e-6
# Directions to which harmonics are fitted, and Gaussians at once.
_DIRECTIONS, _AT_ONCE = 256, 1 << 14


def gaussians_from(
    to_world: Floats,
    positions: Floats,
    rotations: Floats,
    scales: Floats,
    opacities: Floats,
    sh: Floats,
    is_linear: bool,
) -> Gaussians:
    """Gaussians of a glTF node, in the world; all as in `pathtrace.gltf.gaussians.StoredGaussians`.

    ValueError if the node mirrors or shears, for which the extension has no meaning.
    """
    lengths = np.linalg.norm(to_world[:3, :3], axis=0)
    turn = to_world[:3, :3] / np.maximum(lengths, _LEAST_SCALE)
    if not abs(np.linalg.det(turn) - 1) < _SHEAR:
        raise ValueError("the node of Gaussians mirrors or shears, or is flat")
    quaternions, turns = Rotation.from_quat(rotations), not np.array_equal(turn, np.eye(3))
    if np.ptp(lengths) <= _EQUAL * lengths.max():
        scales = scales * lengths.mean()
        quaternions = Rotation.from_matrix(turn) * quaternions if turns else quaternions
    else:
        axes, scales, _ = np.linalg.svd(to_world[:3, :3] @ (quaternions.as_matrix() * scales[:, None]))
        axes[:, :, 2] *= np.linalg.det(axes)[:, None]
        quaternions = Rotation.from_matrix(axes)
    harmonics = torch.from_numpy(np.ascontiguousarray(sh.transpose(1, 2, 0)))
    if is_linear:
        harmonics = refitted(harmonics, perceptual_from_radiance)
    if turns:
        # What is seen along a direction was seen along that direction turned back; no degree mixes.
        directions, count = sphere_directions(_DIRECTIONS), len(harmonics)
        turning = torch.linalg.pinv(_basis(directions, count)) @ _basis(directions @ turn, count)
        harmonics = torch.einsum("jk,kcn->jcn", turning, harmonics)
    with np.errstate(divide="ignore"):
        logits = np.clip(np.log(opacities) - np.log1p(-opacities), -_OPAQUE, _OPAQUE)
    columns = lambda rows: torch.from_numpy(np.ascontiguousarray(rows.T)).float()  # noqa: E731
    return Gaussians(
        columns(positions @ to_world[:3, :3].T + to_world[:3, 3]),
        columns(np.log(np.maximum(scales, _LEAST_SCALE))),
        columns(quaternions.as_quat(scalar_first=True)),
        columns(logits),
        harmonics.float(),
        blending=Blending.LINEAR if is_linear else Blending.DISPLAY,
    )


def save_glb(path: Path, gaussians: Gaussians) -> None:
    """Writes Gaussians as one primitive of a GLB file, in their own coordinates.

    UserError if the file cannot be written, or would be larger than GLB files can be.
    """
    sh = gaussians.all_turning().sh.detach().cpu().double()
    if gaussians.blending is Blending.LINEAR:
        sh = refitted(sh, radiance_from_perceptual)
    turns = quaternions_xyzw(gaussians)
    attributes = {
        "POSITION": rows_of(gaussians.means),
        f"{EXTENSION}:ROTATION": turns / np.linalg.norm(turns, axis=1, keepdims=True),
        f"{EXTENSION}:SCALE": np.exp(rows_of(gaussians.log_scales)),
        f"{EXTENSION}:OPACITY": torch.sigmoid(gaussians.opacity_logits.detach().double()).numpy()[:, None],
    }
    orders = [(d, n) for d in range(gaussians.degree + 1) for n in range(2 * d + 1)]
    for (degree, number), part in zip(orders, sh, strict=True):
        attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"] = rows_of(part)
    parts = {name: rows.astype("<f4") for name, rows in attributes.items()}
    size = sum(part.nbytes for part in parts.values())
    if size > _MOST_BYTES:
        raise UserError(f"{path}: {size:,} bytes; GLB files have at most {_MOST_BYTES:,}")
    text = json.dumps(_tree(parts, _COLOUR_SPACES[gaussians.blending]), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 12 + 8 + len(text) + 8 + size, len(text), 0x4E4F534A)
    content = [head, text, struct.pack("<II", size, 0x004E4942), *(part.tobytes() for part in parts.values())]
    write_whole(path, lambda part: part.write_bytes(b"".join(content)))


def _tree(parts: dict[str, NDArray[Any]], colour_space: str) -> dict[str, Any]:
    """The JSON of a file whose buffer has the attributes of a primitive one after the other."""
    views, accessors, start = [], [], 0
    for number, part in enumerate(parts.values()):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": part.nbytes, "target": _VERTICES})
        kind = {"type": _TYPES[part.shape[1]], "componentType": _FLOAT}
        accessors.append({"bufferView": number, **kind, "count": len(part)})
        start += part.nbytes
    positions = parts["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    described = {"kernel": "ellipse", "colorSpace": colour_space}
    primitive = {
        "mode": _POINTS,
        "attributes": {name: number for number, name in enumerate(parts)},
        "extensions": {EXTENSION: described},
    }
    return {
        "asset": {"version": "2.0", "generator": "foveated-hybrid-renderer"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }


def _basis(directions: Floats, count: int) -> torch.Tensor:
    """(D, K) harmonics along directions (D, 3)."""
    columns = [np.broadcast_to(column, len(directions)) for column in sh_basis(count, list(directions.T))]
    return torch.from_numpy(np.stack(columns, axis=1))


def refitted(sh: torch.Tensor, curve: Callable[[torch.Tensor], torch.Tensor]) -> torch.Tensor:
    """(K, 3, N) harmonics of the colour on another curve: the best ones for all directions together."""
    basis = _basis(sphere_directions(_DIRECTIONS), len(sh))
    back = torch.linalg.pinv(basis)
    found = []
    for part in sh.split(_AT_ONCE, dim=2):
        colours = (torch.einsum("dk,kcn->dcn", basis, part) + 0.5).clamp(min=0)
        found.append(torch.einsum("kd,dcn->kcn", back, curve(colours) - 0.5))
    return torch.cat(found, dim=2)
