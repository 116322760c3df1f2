"""Gaussians of glTF: turned with their node, on the right curve, and written as the extension says."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from compose.base.errors import UserError
from compose.camera.camera import Camera
from splat.io import gltf_gaussians
from splat.io.gltf_gaussians import EXTENSION, gaussians_from, save_glb
from splat.model.gaussians import SH_DC, Blending, Gaussians, perceptual_from_radiance
from splat.raster.differentiable import render_differentiable
from tests.extremes import extreme
from tests.splat.samples import camera, gaussians

COUNT = 40


def stored(sent: Gaussians, **changed: Any) -> dict[str, Any]:
    """As a file has them that is blended on the sRGB curve, at a node that stands at the origin."""
    rows = lambda tensor: tensor.double().numpy().T  # noqa: E731
    return {
        "to_world": np.eye(4),
        "positions": rows(sent.means),
        "rotations": rows(sent.rotations)[:, [1, 2, 3, 0]],
        "scales": np.exp(rows(sent.log_scales)),
        "opacities": torch.sigmoid(sent.opacity_logits.double()).numpy(),
        "sh": sent.sh.double().permute(2, 0, 1).numpy(),
        "is_linear": False,
        **changed,
    }


def written(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The JSON of a GLB file and the arrays of its only primitive, by a reader of its own."""
    content = path.read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4sIIII", content)
    assert (magic, version, length, kind) == (b"glTF", 2, len(content), 0x4E4F534A)
    tree = json.loads(content[20 : 20 + size])
    binary_size, binary_kind = struct.unpack_from("<II", content, 20 + size)
    binary = content[28 + size :]
    assert (binary_kind, binary_size) == (0x004E4942, len(binary))
    assert len(binary) == tree["buffers"][0]["byteLength"]
    arrays = {}
    for name, number in tree["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = tree["accessors"][number]
        view = tree["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays[name] = np.frombuffer(part, "<f4").reshape(accessor["count"], -1)
        assert accessor["type"] == {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[arrays[name].shape[1]]
        assert view["byteOffset"] % 4 == 0
    return tree, arrays


def read_back(path: Path) -> Gaussians:
    _, arrays = written(path)
    own = {name.partition(":")[2]: values.astype(np.float64) for name, values in arrays.items()}
    sh = np.stack([values for name, values in own.items() if name.startswith("SH_")], axis=1)
    rest = own["ROTATION"], own["SCALE"], own["OPACITY"][:, 0]
    return gaussians_from(np.eye(4), arrays["POSITION"].astype(np.float64), *rest, sh, True)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_written_file_is_as_the_extension_says(tmp_path, degree):
    sent = gaussians("overlap", n=COUNT, degree=degree)
    save_glb(tmp_path / "a.glb", sent)
    tree, arrays = written(tmp_path / "a.glb")
    assert tree["extensionsUsed"] == [EXTENSION]
    (primitive,) = tree["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"] == {EXTENSION: {"kernel": "ellipse", "colorSpace": "lin_rec709_display"}}
    orders = [f"SH_DEGREE_{d}_COEF_{n}" for d in range(degree + 1) for n in range(2 * d + 1)]
    assert list(arrays) == [
        "POSITION",
        *(f"{EXTENSION}:{n}" for n in ("ROTATION", "SCALE", "OPACITY", *orders)),
    ]
    assert np.array_equal(arrays["POSITION"].T, sent.means.numpy())
    extremes = tree["accessors"][0]
    assert extremes["min"] == arrays["POSITION"].min(axis=0).tolist()
    assert extremes["max"] == arrays["POSITION"].max(axis=0).tolist()
    turns = arrays[f"{EXTENSION}:ROTATION"]
    assert np.linalg.norm(turns, axis=1) == pytest.approx(1, abs=1e-6)
    expected = torch.nn.functional.normalize(sent.rotations, dim=0)
    assert np.allclose(turns.T, expected[[1, 2, 3, 0]], atol=1e-6)
    assert np.allclose(arrays[f"{EXTENSION}:SCALE"].T, sent.log_scales.exp(), rtol=1e-6)
    assert np.allclose(arrays[f"{EXTENSION}:OPACITY"][:, 0], sent.opacity_logits.sigmoid(), rtol=1e-6)


def test_colours_that_are_the_same_from_all_sides_come_back(tmp_path):
    sent = gaussians("overlap", n=COUNT, degree=2)
    sent.sh[1:] = 0
    sent.sh[0] = torch.linspace(-0.4, 4.0, 3 * COUNT).reshape(3, COUNT) / SH_DC
    save_glb(tmp_path / "a.glb", sent)
    back = read_back(tmp_path / "a.glb")
    for name, bound in (("means", 0), ("log_scales", 1e-6), ("opacity_logits", 1e-5), ("sh", 1e-5)):
        assert (getattr(sent, name) - getattr(back, name)).abs().max() <= bound


def test_what_is_blended_as_displayed_is_written_as_it_is(tmp_path):
    sent = replace(gaussians("overlap", n=COUNT, degree=2), blending=Blending.DISPLAY)
    save_glb(tmp_path / "a.glb", sent)
    tree, arrays = written(tmp_path / "a.glb")
    (primitive,) = tree["meshes"][0]["primitives"]
    assert primitive["extensions"][EXTENSION]["colorSpace"] == "srgb_rec709_display"
    assert np.array_equal(arrays[f"{EXTENSION}:SH_DEGREE_2_COEF_3"].T, sent.sh[7].numpy())
    back = [gaussians_from(**stored(sent, is_linear=linear)).blending for linear in (False, True)]
    assert back == [Blending.DISPLAY, Blending.LINEAR]


def test_what_depends_on_direction_comes_back_nearly(tmp_path, arrays):
    sent = gaussians("overlap", n=COUNT, degree=3)
    sent.sh[1:] *= 0.3
    save_glb(tmp_path / "a.glb", sent)
    expected, found = (
        render_differentiable(arrays, one, camera()).numpy() for one in (sent, read_back(tmp_path / "a.glb"))
    )
    assert expected.max() > 0.3
    assert np.sqrt(((expected - found) ** 2).mean()) < 2e-3


def test_linear_colours_become_those_of_the_srgb_curve():
    sent = gaussians("overlap", n=COUNT, degree=0)
    colour = torch.linspace(0, 3, 3 * COUNT).reshape(3, COUNT)
    sent.sh[0] = (colour - 0.5) / SH_DC
    found = gaussians_from(**stored(sent, is_linear=True))
    assert torch.allclose(found.sh[0] * SH_DC + 0.5, perceptual_from_radiance(colour), atol=1e-5)
    assert torch.allclose(gaussians_from(**stored(sent)).sh, sent.sh, atol=1e-6)


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_a_node_leaves_the_picture_to_a_camera_that_moves_with_it(arrays, scale):
    sent = gaussians("overlap", n=COUNT, degree=3)
    node, view = np.eye(4), camera()
    node[:3, :3] = scale * Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    node[:3, 3] = [0.5, -2.0, 1.0]
    pose = view.world_to_camera @ np.linalg.inv(node)
    pose[:3] *= scale
    moved = Camera(pose, view.width, view.height, view.fx, view.fy, view.cx, view.cy)
    expected = render_differentiable(arrays, replace(sent, blending=Blending.DISPLAY), view).numpy()
    found = render_differentiable(arrays, gaussians_from(**stored(sent, to_world=node)), moved).numpy()
    assert expected.max() > 0.1
    np.testing.assert_allclose(found, expected, atol=5e-4)


def covariances(one: Gaussians) -> np.ndarray:
    turns = Rotation.from_quat(one.rotations.double().numpy().T, scalar_first=True).as_matrix()
    axes = turns * np.exp(one.log_scales.double().numpy().T)[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_a_node_may_stretch_gaussians():
    """The covariance is M C C^T M^T (the extension, Splat Reconstruction)."""
    sent = gaussians("overlap", n=COUNT, degree=1)
    node = np.eye(4)
    node[:3, :3] = Rotation.from_euler("z", 0.7).as_matrix() * [1.0, 2.0, 0.5]
    found = gaussians_from(**stored(sent, to_world=node))
    expected = node[:3, :3] @ covariances(sent) @ node[:3, :3].T
    assert np.abs(covariances(found) - expected).max() < 1e-5 * np.abs(expected).max()
    # The constant harmonic does not turn; the lengths of the others stay.
    assert torch.allclose(found.sh[0], sent.sh[0], atol=1e-6)
    assert torch.allclose(found.sh[1:].norm(dim=0), sent.sh[1:].norm(dim=0), atol=1e-5)


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1, -1, 1]), np.diag([1.0, 0, 1, 1]), np.eye(4) + np.eye(4, k=1)]
)
def test_nodes_that_mirror_or_shear_are_refused(matrix):
    matrix[3] = [0, 0, 0, 1]
    with pytest.raises(ValueError, match="the node of Gaussians mirrors or shears, or is flat"):
        gaussians_from(**stored(gaussians(n=2, degree=0), to_world=matrix))


@extreme(
    "Gaussians of glTF at the ends of their ranges",
    given="opacities 0 and 1, scales 0 and 1e30",
    expected="finite Gaussians, invisible and opaque",
)
def test_ends_of_ranges_are_finite(got):
    sent = gaussians("overlap", n=2, degree=0)
    scales = np.array([[0.0, 0, 0], [1e30] * 3])
    found = gaussians_from(**stored(sent, opacities=np.array([0.0, 1.0]), scales=scales))
    assert found.is_finite()
    assert got(found.opacity_logits.sigmoid().tolist()) == pytest.approx([0, 1], abs=1e-8)


def test_a_file_that_would_be_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_gaussians, "_MOST_BYTES", 100)
    with pytest.raises(UserError, match=r"a\.glb: .* bytes; GLB files have at most 100"):
        save_glb(tmp_path / "a.glb", gaussians(n=2, degree=0))
    assert not list(tmp_path.iterdir())
