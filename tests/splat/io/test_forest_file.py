"""Forest files and PLY: what is written reads back equal, and damage is named."""

from __future__ import annotations

import pytest
import torch

from compose.base.errors import UserError
from splat.io.forest_file import load_forest, save_forest
from splat.io.ply import export_ply, import_ply
from splat.io.tensors import load_tensors, save_tensors
from splat.model.building import build_forest
from splat.model.forest import Forest, forest_of, static_layer
from splat.model.gaussians import Gaussians
from tests.conftest import real_file
from tests.splat.samples import camera, gaussians


def forest() -> Forest:
    layers = build_forest(static_layer(gaussians("overlap", n=20, degree=2)), 0.2, 3)
    return forest_of(layers, 120.5, "somewhere", "ab" * 32)


def same(a: Gaussians, b: Gaussians) -> bool:
    return all(torch.equal(x, y) for (_, x), (_, y) in zip(a.tensors(), b.tensors(), strict=True))


def test_a_forest_reads_back_equal(tmp_path):
    save_forest(tmp_path / "f.safetensors", forest())
    back = load_forest(tmp_path / "f.safetensors")
    assert same(back.nodes.gaussians, forest().nodes.gaussians)
    assert back.counts == forest().counts
    for name in ("parent", "semantic", "dynamic"):
        assert torch.equal(getattr(back.nodes, name), getattr(forest().nodes, name))
    # The layers share the memory of all nodes.
    assert back.layers[0].gaussians.means.data_ptr() == back.nodes.gaussians.means.data_ptr()
    assert (back.trained_focal, back.scene_name, back.scene_hash) == (120.5, "somewhere", "ab" * 32)
    assert [p.name for p in tmp_path.iterdir()] == ["f.safetensors"]


@pytest.mark.parametrize("keep", [0, 7, 100, -1])
def test_a_truncated_forest_is_named(tmp_path, keep):
    path = tmp_path / "f.safetensors"
    save_forest(path, forest())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UserError, match=r"f\.safetensors: truncated or corrupt") as caught:
        load_forest(path)
    assert "\n" not in str(caught.value)


def test_other_files_are_not_forests(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        load_forest(tmp_path / "nowhere")
    save_tensors(tmp_path / "other", {"a": torch.zeros(3)}, {})
    with pytest.raises(UserError, match="not a forest file"):
        load_forest(tmp_path / "other")
    save_tensors(tmp_path / "new", {"a": torch.zeros(3)}, {"format_version": 99, "kind": "forest"})
    with pytest.raises(UserError, match="format version 99"):
        load_forest(tmp_path / "new")


def test_missing_and_wrong_numbers_are_named(tmp_path):
    save_forest(tmp_path / "good", forest())
    tensors, metadata = load_tensors(tmp_path / "good")
    counts = forest().counts
    parent, semantic = tensors["parent"].clone(), tensors["semantic"].clone()
    orphan, crowded, moved = parent.clone(), parent.clone(), semantic.clone()
    orphan[-1] = -1
    crowded[counts[0] : counts[0] + counts[1]] = 0
    moved[-1] = 4
    for broken, changes, complaint in (
        ({k: v for k, v in tensors.items() if k != "sh"}, {}, "damaged"),
        ({**tensors, "means": tensors["means"][:, :5]}, {}, "damaged"),
        ({**tensors, "means": tensors["means"] * float("nan")}, {}, "not finite"),
        (tensors, {"layers": []}, "zero layers"),
        (tensors, {"layers": [*counts, 3]}, "do not make up"),
        ({k: v[..., :0] for k, v in tensors.items()}, {"layers": [0]}, "holds no nodes"),
        ({**tensors, "parent": orphan}, {}, "broken tree: node 19 of layer 3 has no parent"),
        ({**tensors, "parent": crowded}, {}, "broken tree: node 1 of layer 1 has no child"),
        ({**tensors, "semantic": moved}, {}, "labels disagree: node 19 of layer 3"),
    ):
        save_tensors(tmp_path / "f", broken, {**metadata, **changes})
        with pytest.raises(UserError, match=complaint) as caught:
            load_forest(tmp_path / "f")
        assert "\n" not in str(caught.value)


def test_a_folder_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        save_forest(tmp_path / "file" / "f", forest())


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_ply_reads_back_equal(tmp_path, degree):
    original = gaussians("overlap", n=11, degree=degree)
    export_ply(tmp_path / "g.ply", original)
    back = import_ply(tmp_path / "g.ply")
    original.rotations = torch.nn.functional.normalize(original.rotations, dim=0)
    assert same(back, original)


def test_a_real_ply_imports_and_renders(arrays):
    found = import_ply(real_file("splats/kacytran_try_it7000.ply"))
    assert len(found) > 5000
    assert found.is_finite()
    import numpy as np

    from compose.camera.camera import camera_from_pose, look_at
    from splat.lod.pictures import ForestRenderer

    centre = found.means.median(dim=1).values.double().numpy()
    spread = float((found.means - found.means.median(dim=1, keepdim=True).values).norm(dim=0).median())
    pose = look_at(centre + np.array([0, 0, -3 * spread]), centre, np.array([0.0, -1, 0]))
    forest = forest_of([static_layer(found)], 1e9, "", "")
    camera = camera_from_pose(pose, 96, 96, 100, 100, 48, 48)
    image = ForestRenderer(arrays, forest).render_layer(camera, 1).image()
    assert np.isfinite(image).all()
    assert (image.max(axis=2) > 0.02).mean() > 0.2


def test_mitsubas_ellipsoids_open_our_ply_and_agree(tmp_path, arrays):
    """One wide Gaussian: Mitsuba takes alpha at the ray's peak, the rasterizer integrates its footprint."""
    import mitsuba as mi
    import numpy as np

    from compose.camera.axes import mitsuba_from_opencv
    from splat.model.gaussians import SH_DC
    from splat.raster.differentiable import render_differentiable

    cam = camera(48, 48)
    cam = type(cam)(cam.world_to_camera, 48, 48, 45.0, 45.0, 24, 24)
    one = Gaussians(
        torch.tensor([[0.0], [0.1], [0.2]]),
        torch.log(torch.tensor([[0.25], [0.12], [0.18]])),
        torch.tensor([[0.9], [0.1], [0.3], [-0.2]]),
        torch.tensor([0.4]),
        torch.tensor([0.3, 0.1, -0.2])[None, :, None] / SH_DC,
    )
    export_ply(tmp_path / "one.ply", one)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volprim_rf_basic", "max_depth": 8, "srgb_primitives": False},
            "g": {"type": "ellipsoids", "filename": str(tmp_path / "one.ply")},
            "sensor": {
                "type": "perspective",
                "fov": cam.vertical_fov,
                "to_world": mi.ScalarTransform4f(mitsuba_from_opencv(cam.camera_to_world)),
                "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}},
            },
        }
    )
    theirs = mi.render(scene, spp=64).numpy()[..., :3]
    perceptual = torch.tensor([0.8, 0.6, 0.3])
    linear = ((perceptual + 0.055) / 1.055) ** 2.4
    # Without srgb_primitives Mitsuba shows the stored colours as they are: compare coverage.
    ours = render_differentiable(arrays, one, cam).numpy() / linear.numpy() * perceptual.numpy()
    # Worst seen 0.008: the affine approximation of the projection.
    np.testing.assert_allclose(ours, theirs, atol=0.02)


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nend_header\n", b"PK\x03\x04"])
def test_other_ply_files_are_refused(tmp_path, content):
    (tmp_path / "x.ply").write_bytes(content)
    with pytest.raises(UserError, match=r"x\.ply"):
        import_ply(tmp_path / "x.ply")


def test_a_truncated_ply_is_refused(tmp_path):
    export_ply(tmp_path / "g.ply", gaussians("overlap", n=11, degree=1))
    content = (tmp_path / "g.ply").read_bytes()
    (tmp_path / "g.ply").write_bytes(content[:-10])
    with pytest.raises(UserError, match="truncated"):
        import_ply(tmp_path / "g.ply")


@pytest.mark.parametrize("count", [b"x", b"", b"0", b"-11", b"1.5", b"9" * 5000])
def test_a_ply_whose_number_of_gaussians_is_none_is_refused_by_name(tmp_path, count):
    export_ply(tmp_path / "g.ply", gaussians("overlap", n=11, degree=1))
    content = (tmp_path / "g.ply").read_bytes()
    (tmp_path / "g.ply").write_bytes(content.replace(b"element vertex 11", b"element vertex " + count))
    with pytest.raises(UserError, match=r"g\.ply: element vertex .*: must be a number of Gaussians"):
        import_ply(tmp_path / "g.ply")


@pytest.mark.parametrize("name", [b"", b"f_rest_9"])
def test_a_ply_with_a_property_that_has_no_place_is_named(tmp_path, name):
    export_ply(tmp_path / "g.ply", gaussians("overlap", n=11, degree=1))
    content = (tmp_path / "g.ply").read_bytes()
    line = b"property float " + name + b"\nproperty float opacity"
    (tmp_path / "g.ply").write_bytes(content.replace(b"property float opacity", line))
    with pytest.raises(UserError, match=r"g\.ply"):
        import_ply(tmp_path / "g.ply")
