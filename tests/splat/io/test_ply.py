"""PLY files: what is written reads back equal, other programs open it, and other files are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from compose.base.errors import UserError
from compose.camera.camera import Camera, camera_from_pose, look_at
from compose.camera.coordinate_systems import mitsuba_from_opencv
from splat.io.ply import UNBOUND_FOCAL, load_ply, save_ply
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import forest_of
from splat.model.gaussians import SH_DC, Blending, Gaussians
from splat.model.trees import static_layer
from splat.raster.differentiable import render_differentiable
from tests.conftest import real_file
from tests.splat.samples import camera, equal, gaussians


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_gaussians_read_back_equal(tmp_path, degree):
    original = gaussians("overlap", n=11, degree=degree)
    save_ply(tmp_path / "g.ply", original)
    back = load_ply(tmp_path / "g.ply")
    # A path may be a string, and tensors may require gradients.
    original.means.requires_grad_()
    save_ply(str(tmp_path / "again.ply"), original)
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "g.ply").read_bytes()
    assert equal(load_ply(str(tmp_path / "g.ply")), back)
    original.rotations = torch.nn.functional.normalize(original.rotations, dim=0)
    assert equal(back, original)


def test_the_layout_is_that_of_the_inria_implementation(tmp_path):
    """One Gaussian of degree 1, number by number; f_rest holds all of red, then green, then blue."""
    one = Gaussians(
        torch.tensor([[1.0], [2.0], [3.0]]),
        torch.tensor([[4.0], [5.0], [6.0]]),
        torch.tensor([[2.0], [0.0], [0.0], [0.0]]),
        torch.tensor([7.0]),
        torch.arange(12.0).reshape(4, 3, 1),
    )
    save_ply(tmp_path / "one.ply", one)
    header, body = (tmp_path / "one.ply").read_bytes().split(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert lines[2:4] == ["comment blending linear", "element vertex 1"]
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(9))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert lines[4:] == [f"property float {name}" for name in names]
    numbers = [1, 2, 3, 0, 0, 0, 0, 1, 2, 3, 6, 9, 4, 7, 10, 5, 8, 11, 7, 4, 5, 6, 1, 0, 0, 0]
    assert np.frombuffer(body, "<f4").tolist() == numbers


@pytest.mark.parametrize("blending", Blending)
def test_blending_is_kept_and_that_of_other_programs_without_a_word(tmp_path, blending):
    save_ply(tmp_path / "g.ply", replace(gaussians("overlap", n=3), blending=blending))
    content = (tmp_path / "g.ply").read_bytes()
    assert (b"comment" in content) == (blending is Blending.LINEAR)
    assert load_ply(tmp_path / "g.ply").blending is blending
    (tmp_path / "g.ply").write_bytes(content.replace(b"comment blending linear\n", b""))
    assert load_ply(tmp_path / "g.ply").blending is Blending.DISPLAY


def test_properties_are_found_by_name(tmp_path):
    """Other programs write them in another order, leave the normals out and add properties of their own."""
    save_ply(tmp_path / "g.ply", gaussians("overlap", n=3, degree=0))
    header, body = (tmp_path / "g.ply").read_bytes().split(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property")]
    table = dict(zip(names, np.frombuffer(body, "<f4").reshape(3, -1).T, strict=True))
    table["confidence"] = np.ones(3, dtype="<f4")
    order = [name for name in reversed(table) if name not in ("nx", "ny", "nz")]
    head = ["ply", "format binary_little_endian 1.0", "comment by hand", "element vertex 3"]
    head += [f"property float {name}" for name in order] + ["end_header", ""]
    columns = np.stack([table[name] for name in order], axis=1)
    (tmp_path / "h.ply").write_bytes("\n".join(head).encode() + columns.tobytes())
    assert equal(load_ply(tmp_path / "h.ply"), load_ply(tmp_path / "g.ply"))


def test_a_real_file_loads_and_renders(arrays):
    found = load_ply(real_file("splats/kacytran_try_it7000.ply"))
    assert len(found) > 5000
    assert found.is_finite()
    centre = found.means.median(dim=1).values.double().numpy()
    spread = float((found.means - found.means.median(dim=1, keepdim=True).values).norm(dim=0).median())
    pose = look_at(centre + np.array([0, 0, -3 * spread]), centre, np.array([0.0, -1, 0]))
    forest = forest_of([static_layer(found)], UNBOUND_FOCAL, "", "")
    view = camera_from_pose(pose, 96, 96, 100, 100, 48, 48)
    image = ForestRenderer(arrays, forest).render_layer(view, 1).numpy()
    assert np.isfinite(image).all()
    assert (image.max(axis=2) > 0.02).mean() > 0.2


def test_mitsubas_ellipsoids_open_our_files_and_agree(tmp_path, arrays):
    """One wide Gaussian: Mitsuba evaluates alpha at the ray's peak, the rasterizer integrates a footprint."""
    mi = pytest.importorskip("mitsuba")
    if mi.variant() is None:
        mi.set_variant(f"{arrays.backend}_ad_rgb")
    tilted = camera(48, 48)
    cam = Camera(tilted.world_to_camera, 48, 48, 45.0, 45.0, 24, 24)
    one = Gaussians(
        torch.tensor([[0.0], [0.1], [0.2]]),
        torch.log(torch.tensor([[0.25], [0.12], [0.18]])),
        torch.tensor([[0.9], [0.1], [0.3], [-0.2]]),
        torch.tensor([0.4]),
        torch.tensor([0.3, 0.1, -0.2])[None, :, None] / SH_DC,
    )
    save_ply(tmp_path / "one.ply", one)
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
    assert ours.max() > 0.3
    # Worst seen 0.008: the affine approximation of the projection.
    np.testing.assert_allclose(ours, theirs, atol=0.02)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_files_of_other_programs_are_read_whatever_their_order_and_types(tmp_path, text, order, caplog):
    """With elements before and after, numbers of other types, and lines that end as on Windows."""
    save_ply(tmp_path / "g.ply", gaussians("overlap", n=7, degree=1))
    table = PlyData.read(tmp_path / "g.ply")["vertex"].data
    kinds = [(name, "f8" if k % 2 else "f4") for k, name in enumerate(table.dtype.names)] + [("label", "u1")]
    other = np.zeros(7, kinds)
    for name in table.dtype.names:
        other[name] = table[name]
    faces = np.array([([0, 1, 2],)], dtype=[("vertex_indices", "i4", (3,))])
    elements = [
        PlyElement.describe(np.zeros(3, [("x", "f4"), ("opacity", "f8")]), "camera"),
        PlyElement.describe(other, "vertex"),
        PlyElement.describe(faces, "face"),
        PlyElement.describe(faces[:0], "nothing"),
    ]
    PlyData(elements, text=text, byte_order=order).write(tmp_path / "h.ply")
    if text:
        content = (tmp_path / "h.ply").read_bytes().replace(b"\n", b"\r\n")
        (tmp_path / "h.ply").write_bytes(content)
    with caplog.at_level("INFO", logger="hybrid"):
        assert equal(load_ply(tmp_path / "h.ply"), load_ply(tmp_path / "g.ply"))
    assert [record.getMessage().split("h.ply")[1] for record in caplog.records] == [
        ": left out: label, camera, face, nothing"
    ]


def test_infinite_logits_are_opaque_or_invisible(tmp_path):
    some = gaussians("overlap", n=3, degree=0)
    some.opacity_logits[:] = torch.tensor([torch.inf, -torch.inf, 0.5])
    save_ply(tmp_path / "g.ply", some)
    found = load_ply(tmp_path / "g.ply").opacity_logits
    assert found.isfinite().all()
    np.testing.assert_array_equal(torch.sigmoid(found[:1]), 1)
    assert torch.sigmoid(found[1]) < 1e-8
    assert found[2] == 0.5


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a PLY file"),
        (b"PK\x03\x04 end_header", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nend_header\n", "it has no element vertex"),
        (
            b"ply\nformat ascii 1.0\nelement face 0\nproperty list uchar int i\nend_header\n",
            "no element vertex",
        ),
        (b"ply\nformat morse 1.0\nend_header\n", "cannot be read"),
    ],
)
def test_other_files_are_refused(tmp_path, content, said):
    (tmp_path / "x.ply").write_bytes(content)
    with pytest.raises(UserError, match=rf"x\.ply: .*{said}"):
        load_ply(tmp_path / "x.ply")
    with pytest.raises(UserError, match=r"y\.ply: no such file"):
        load_ply(tmp_path / "y.ply")


def edited(tmp_path, old: bytes, new: bytes) -> None:
    """Writes g.ply with a piece of it replaced."""
    save_ply(tmp_path / "g.ply", gaussians("overlap", n=11, degree=1))
    content = (tmp_path / "g.ply").read_bytes()
    assert old in content
    (tmp_path / "g.ply").write_bytes(content.replace(old, new))


def test_a_truncated_file_is_refused(tmp_path):
    edited(tmp_path, b"", b"")
    content = (tmp_path / "g.ply").read_bytes()
    (tmp_path / "g.ply").write_bytes(content[:-1])
    with pytest.raises(UserError, match=r"g\.ply: cannot be read \(.*early end-of-file"):
        load_ply(tmp_path / "g.ply")


@pytest.mark.parametrize("count", [b"x", b"", b"0", b"-11", b"1.5", b"9" * 5000])
def test_an_impossible_number_of_gaussians_is_named(tmp_path, count):
    edited(tmp_path, b"element vertex 11", b"element vertex " + count)
    with pytest.raises(
        UserError, match=r"g\.ply: (cannot be read \(.*element vertex|0 Gaussians; must be 1)"
    ):
        load_ply(tmp_path / "g.ply")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"property float opacity", b"property float f_rest_9\nproperty float opacity"),
        (b"property float opacity", b"property float transparency"),
        (b"property float scale_2", b"property float scale_3"),
        (b"property float f_rest_8\n", b""),
        (b"property float scale_2", b"property list uchar float scale_2"),
    ],
)
def test_unknown_properties_are_refused(tmp_path, old, new):
    """Those that change the length of a row make the file too short, too."""
    edited(tmp_path, old, new)
    with pytest.raises(UserError, match=r"g\.ply: (not a 3D Gaussian splatting PLY|cannot be read)"):
        load_ply(tmp_path / "g.ply")


def test_harmonics_that_others_lack_are_zero_in_the_file(tmp_path):
    some = gaussians(n=9, degree=2).turning(torch.arange(9) < 3)
    save_ply(tmp_path / "a.ply", some)
    found = load_ply(tmp_path / "a.ply")
    assert torch.equal(found.sh, some.all_turning().sh)
