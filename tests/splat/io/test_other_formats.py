"""Gaussians in the formats of web viewers: what goes out comes back, as exactly as each format has it."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from compose.base.errors import UserError
from compose.camera.camera import Camera
from splat.io import other_formats
from splat.io.other_formats import half_turned, load_gaussians, save_gaussians
from splat.io.ply import save_ply
from splat.model.gaussians import SH_DC, Gaussians
from splat.raster.differentiable import render_differentiable
from tests.splat.samples import camera, gaussians

NEEDED = pytest.mark.skipif(
    other_formats.importlib.util.find_spec("gaussforge") is None, reason="gaussforge is not installed"
)


def some(degree: int) -> Gaussians:
    """Gaussians whose numbers all formats can hold."""
    found = gaussians("overlap", n=200, degree=degree)
    rng = torch.Generator().manual_seed(0)
    uniform = lambda low, high, *shape: low + (high - low) * torch.rand(*shape, generator=rng)  # noqa: E731
    found.means[:] = uniform(-2, 2, 3, 200)
    found.log_scales[:] = uniform(-5, -1, 3, 200)
    found.opacity_logits[:] = uniform(-3, 3, 200)
    found.sh[0] = uniform(-0.4, 0.4, 3, 200) / SH_DC
    found.sh[1:] = uniform(-0.3, 0.3, *found.sh[1:].shape)
    return found


def in_the_order_of(sent: Gaussians, back: Gaussians) -> Gaussians:
    """Each by its nearest neighbour: some formats sort them."""
    return back.select((sent.means.T[:, None] - back.means.T[None]).norm(dim=2).argmin(dim=1))


# Largest errors of means, logarithms of scales, opacities and colours, and the degree that is kept.
FORMATS = {
    "a.ply": (0, 0, 0, 0, 3),
    "a.splat": (1e-6, 1e-5, 1 / 250, 1 / 250, 0),
    "a.ksplat": (2e-3, 2e-2, 1 / 250, 1 / 100, 3),
    "a.spz": (1e-3, 1 / 30, 1 / 250, 1 / 60, 3),
    "a.sog": (2e-3, 0.1, 1 / 100, 1 / 50, 3),
}


@NEEDED
@pytest.mark.parametrize("name", FORMATS)
def test_what_goes_out_comes_back(tmp_path, name):
    *bounds, degree = FORMATS[name]
    sent = some(degree)
    save_gaussians(tmp_path / name, sent)
    back = load_gaussians(tmp_path / name)
    assert (len(back), back.degree) == (200, degree)
    back = in_the_order_of(sent, back)
    pairs = [
        (sent.means, back.means),
        (sent.log_scales, back.log_scales),
        (sent.opacity_logits.sigmoid(), back.opacity_logits.sigmoid()),
        (sent.sh[0] * SH_DC, back.sh[0] * SH_DC),
    ]
    for (ours, theirs), bound in zip(pairs, bounds, strict=True):
        assert (ours - theirs).abs().max() <= bound
    # All degrees, in what is left of their bits.
    assert (sent.sh - back.sh).abs().max() < 0.15
    turns = [torch.nn.functional.normalize(one.rotations, dim=0) for one in (sent, back)]
    assert (turns[0] * turns[1]).sum(dim=0).abs().min() > 0.999


@NEEDED
def test_positions_of_spz_are_in_its_own_axes(tmp_path):
    """Right, up and back, where PLY has right, down and forward (the format's own description)."""
    sent = some(0)
    save_gaussians(tmp_path / "a.spz", sent)
    content = gzip.decompress((tmp_path / "a.spz").read_bytes())
    count, bits = int.from_bytes(content[8:12], "little"), content[13]
    raw = np.frombuffer(content[16 : 16 + 9 * count], np.uint8).reshape(count, 3, 3).astype(np.int32)
    whole = raw[..., 0] | raw[..., 1] << 8 | raw[..., 2] << 16
    position = np.where(whole >= 1 << 23, whole - (1 << 24), whole) / 2.0**bits
    expected = sent.means.T.numpy() * [1, -1, -1]
    assert np.abs(np.sort(position, axis=0) - np.sort(expected, axis=0)).max() < 1e-3


def test_half_a_turn_leaves_the_picture_to_a_camera_that_turns_with_it(arrays):
    sent = gaussians("overlap", n=40, degree=3)
    view = camera(40, 30)
    turned = Camera(
        view.world_to_camera @ np.diag([1.0, -1, -1, 1]), 40, 30, view.fx, view.fy, view.cx, view.cy
    )
    expected = render_differentiable(arrays, sent, view).numpy()
    found = render_differentiable(arrays, half_turned(sent), turned).numpy()
    assert expected.max() > 0.1
    np.testing.assert_allclose(found, expected, atol=2e-4)


@NEEDED
def test_a_compressed_ply_is_read_whatever_its_name_and_not_written(tmp_path):
    save_ply(tmp_path / "a.ply", some(0))
    convert = other_formats._convert
    convert(tmp_path / "a.ply", "ply", tmp_path / "b.ply", "compressed.ply", tmp_path)
    back = load_gaussians(tmp_path / "b.ply")
    assert (some(0).means - in_the_order_of(some(0), back).means).abs().max() < 5e-3
    with pytest.raises(UserError, match=r"c\.compressed\.ply: compressed PLY files are only read"):
        save_gaussians(tmp_path / "c.compressed.ply", some(0))


@NEEDED
@pytest.mark.parametrize("name", ["a.ksplat", "a.spz", "a.sog"])
@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", bytes(70), b"\xff" * 999])
def test_damaged_files_are_refused_in_a_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError, match=name) as refused:
        load_gaussians(tmp_path / name)
    assert "\n" not in str(refused.value)


def test_a_name_that_tells_no_format_is_refused_unless_the_file_is_a_ply(tmp_path):
    save_ply(tmp_path / "a.bin", some(1))
    assert len(load_gaussians(tmp_path / "a.bin")) == 200
    (tmp_path / "b.bin").write_bytes(b"something else")
    for act in (lambda: load_gaussians(tmp_path / "b.bin"), lambda: save_gaussians(tmp_path / "c", some(0))):
        with pytest.raises(UserError, match=r"must end in \.glb, \.ply, \.ksplat"):
            act()
    with pytest.raises(UserError, match=r"a\.spz: no such file"):
        load_gaussians(tmp_path / "a.spz")


def test_what_is_needed_and_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(other_formats.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"a\.spz: needs gaussforge; pip install '.*\[formats\]'"):
        save_gaussians(tmp_path / "a.spz", some(0))
    assert not list(tmp_path.iterdir())


def test_a_crash_of_the_converter_is_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(other_formats.importlib.util, "find_spec", lambda name: True)
    monkeypatch.setattr(other_formats, "_CONVERSION", "import os; os.abort()")
    with pytest.raises(UserError, match=r"a\.spz: cannot be converted \(its reader ended with -6\)"):
        save_gaussians(Path(tmp_path / "a.spz"), some(0))
    assert sys.exc_info() == (None, None, None)
