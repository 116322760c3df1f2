"""Pixels of posed images."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from compose.image.colour import bytes_from_radiance, radiance_from_srgb, srgb_from_radiance
from pathtrace.dataset.posed_images import Lens, read_pixels
from pathtrace.dataset.posed_layouts import read_posed_folder
from tests import posed


def test_radiance_is_linear_and_lies_over_white(tmp_path):
    image = read_posed_folder(posed.write_synthetic(tmp_path / "a")).training[0]
    pixels = read_pixels(image)
    file = np.asarray(Image.open(image.file), dtype=np.float64) / 255
    srgb, alpha = file[..., :3], file[..., 3:]
    blended = srgb * alpha + 1 - alpha
    expected = np.where(blended <= 0.04045, blended / 12.92, ((blended + 0.055) / 1.055) ** 2.4)
    assert np.allclose(pixels.radiance, expected, atol=1e-6)
    assert pixels.alpha is not None
    assert np.array_equal(pixels.alpha, alpha[..., 0])
    assert (pixels.radiance[pixels.alpha == 0] == 1).all()
    assert pixels.moving is None


def test_opaque_images_have_no_alpha(tmp_path):
    image = read_posed_folder(posed.write_synthetic(tmp_path / "a", alpha=False)).training[0]
    assert read_pixels(image).alpha is None


def test_srgb_and_radiance_are_inverse():
    values = np.linspace(0, 1, 256, dtype=np.float32).reshape(16, 16, 1).repeat(3, axis=2)
    assert np.allclose(srgb_from_radiance(radiance_from_srgb(values)), values, atol=1e-6)
    assert (bytes_from_radiance(radiance_from_srgb(values)) == np.round(values * 255)).all()


@pytest.mark.parametrize("suffix", [".png", ".png.png"])
def test_labels_say_what_moves_in_both_conventions(tmp_path, suffix):
    found = read_posed_folder(posed.write_nerfies(tmp_path / "a", labels=suffix))
    for image in found.images[:3]:
        _, ball, _ = posed.cast(posed.camera(int(image.file.stem)), image.time)
        assert np.array_equal(read_pixels(image).moving, ball)


def test_distortion_is_undone_in_image_and_labels(tmp_path):
    lens = Lens((0.5, -0.1, 0.0), (0.01, 0.005))
    image = read_posed_folder(posed.write_nerfies(tmp_path / "a", labels=".png", lens=lens)).images[0]
    pixels, plain = read_pixels(image), read_pixels(replace(image, lens=None))
    assert pixels.camera.width < plain.camera.width
    wrong = []
    for found in (pixels, plain):
        _, ball, colour = posed.cast(found.camera, image.time)
        assert found.moving is not None
        assert (found.moving != ball).mean() < 0.01
        wrong.append((np.abs(srgb_from_radiance(found.radiance) - colour).max(axis=2) > 0.2).mean())
    # What is left is at edges, which are interpolated.
    assert wrong[0] < 0.08
    assert wrong[1] > 2 * wrong[0]


def test_a_truncated_image_is_refused(tmp_path):
    image = read_posed_folder(posed.write_synthetic(tmp_path / "a")).training[0]
    content = image.file.read_bytes()
    image.file.write_bytes(content[: len(content) // 2])
    with pytest.raises(UserError, match="not a readable image"):
        read_pixels(image)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_16_bits_of_a_png_are_kept(tmp_path, backend, channels):
    image = read_posed_folder(posed.write_synthetic(tmp_path / "a")).training[0]
    shape = image.camera.height, image.camera.width, channels
    values = np.random.default_rng(0).integers(0, 1 << 16, shape).astype(np.uint16)
    mi.Bitmap(values).write(str(image.file))
    found = read_pixels(image)
    part = values.astype(np.float64) / 65535
    colour = part[..., :3] if channels > 2 else part[..., :1].repeat(3, axis=2)
    alpha = part[..., -1:] if channels in (2, 4) else np.ones((*shape[:2], 1))
    # 8 bits would be off by up to 0.002.
    assert np.allclose(srgb_from_radiance(found.radiance), colour * alpha + 1 - alpha, atol=2e-6)
    assert (found.alpha is None) == (channels in (1, 3))


def test_a_truncated_image_of_16_bits_is_refused(tmp_path, backend):
    image = read_posed_folder(posed.write_synthetic(tmp_path / "a")).training[0]
    values = np.random.default_rng(0).integers(0, 1 << 16, (32, 48, 3)).astype(np.uint16)
    mi.Bitmap(values).write(str(image.file))
    content = image.file.read_bytes()
    for size in (40, len(content) // 2):
        image.file.write_bytes(content[:size])
        with pytest.raises(UserError, match=r"r_000\.png: not a readable image"):
            read_pixels(image)
