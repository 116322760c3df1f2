"""Image files: EXR with named AOVs in linear radiance, PNG in sRGB."""

from __future__ import annotations

import os

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from compose.base.errors import UserError
from hybrid.render.image_files import check_writable, read_exr, write_exr, write_png, write_srgb
from tests import small


def test_every_channel_of_an_exr_file_is_what_was_written(tmp_path):
    radiance = small.rng().normal(size=(5, 7, 3)).astype(np.float32) * 1e4
    depth = np.full((5, 7), np.inf, dtype=np.float32)
    write_exr(tmp_path / "a.exr", {"": radiance, "splat": radiance + 1, "depth": depth})
    found = read_exr(tmp_path / "a.exr")
    assert {*found} == {"R", "G", "B", "splat.R", "splat.G", "splat.B", "depth.V"}
    for index, channel in enumerate("RGB"):
        np.testing.assert_array_equal(found[channel], radiance[..., index])
        np.testing.assert_array_equal(found[f"splat.{channel}"], radiance[..., index] + 1)
    np.testing.assert_array_equal(found["depth.V"], depth)


def test_other_numbers_are_written_as_32_bit_floats(tmp_path):
    write_exr(tmp_path / "a.exr", {"level": np.full((2, 3), 1 / 3), "rate": np.ones((2, 3), dtype=int)})
    found = read_exr(tmp_path / "a.exr")
    assert {image.dtype for image in found.values()} == {np.dtype(np.float32)}
    assert (found["level.V"] == np.float32(1 / 3)).all()


def test_an_exr_file_is_compressed_scan_lines_of_floats(tmp_path):
    write_exr(tmp_path / "a.exr", {"": np.zeros((64, 64, 3), dtype=np.float32)})
    header = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).header()
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["type"] == OpenEXR.scanlineimage
    assert (tmp_path / "a.exr").stat().st_size < 64 * 64 * 3


def test_a_png_file_shows_radiance_in_srgb(tmp_path):
    # Black, the standard's break at 0.04045 / 12.92, middle grey, white, and a lamp.
    levels = np.array([0, 0.0031308, 0.2158605, 1, 50], dtype=np.float32)
    write_png(tmp_path / "a.png", np.repeat(levels[None, :, None], 3, axis=2))
    image = np.asarray(Image.open(tmp_path / "a.png"))
    assert image.shape == (1, 5, 3)
    np.testing.assert_array_equal(image[0, :, 1], [0, 10, 128, 255, 255])


def test_an_image_in_srgb_is_written_as_it_is(tmp_path):
    image = small.rng().integers(0, 256, (3, 4, 3), dtype=np.uint8)
    write_srgb(tmp_path / "new" / "a.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "new" / "a.png")), image)


def test_a_png_file_needs_no_extension_to_be_one(tmp_path):
    write_srgb(tmp_path / "a", np.zeros((2, 2, 3), dtype=np.uint8))
    assert Image.open(tmp_path / "a").format == "PNG"


def test_a_file_that_cannot_be_written_is_named_and_leaves_nothing(tmp_path):
    (tmp_path / "a.exr").mkdir()
    with pytest.raises(UserError, match=r"a\.exr: cannot be written"):
        write_exr(tmp_path / "a.exr", {"": np.zeros((2, 2, 3), dtype=np.float32)})
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]


def test_the_folder_of_a_file_is_created_before_the_work(tmp_path):
    check_writable(tmp_path / "a" / "b" / "c.png")
    assert (tmp_path / "a" / "b").is_dir()
    check_writable(tmp_path / "a" / "b" / "c.png")
    assert not list((tmp_path / "a" / "b").iterdir())


def test_a_file_in_the_place_of_a_folder_is_refused_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match=r"file/a\.png: its folder cannot be created \(File exists\)"):
        check_writable(tmp_path / "file" / "a.png")


def test_a_folder_in_the_place_of_a_file_is_refused_before_the_work(tmp_path):
    with pytest.raises(UserError, match=f"^{tmp_path}: cannot be written$"):
        check_writable(tmp_path)


def test_a_folder_without_permission_is_refused_before_the_work(tmp_path, monkeypatch):
    for lacking in (os.W_OK, os.X_OK):
        monkeypatch.setattr(os, "access", lambda path, mode, lacking=lacking: not mode & lacking)
        with pytest.raises(UserError, match=r"a\.png: cannot be written"):
            check_writable(tmp_path / "a.png")
