"""A frame and its files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from compose.base.errors import UserError
from compose.image.colour import bytes_from_radiance
from hybrid.render.frame import Frame
from hybrid.render.frame_settings import EXTRA_AOVS, FrameSettings
from hybrid.render.image_files import read_exr
from tests.compose.arrays_of import channels


@pytest.fixture(scope="module")
def frame(renderer) -> Frame:
    camera = renderer.scene.camera.resized(40, 30)
    return renderer.frame(FrameSettings((0.3, 0.7), 40, 20, 1, camera=camera, aovs=EXTRA_AOVS))


def test_values_of_the_disc_lie_at_its_pixels(frame, arrays):
    values = np.arange(2 * len(frame.region.pixels), dtype=np.float32).reshape(-1, 2) + 1
    image = frame.of_disc(channels(arrays, values))
    assert image.shape == (30, 40, 2)
    np.testing.assert_array_equal(image.reshape(-1, 2)[frame.region.pixels], values)
    assert (image > 0).sum() == values.size


def test_the_exr_file_holds_every_image_of_the_frame(frame, renderer, tmp_path):
    frame.save(tmp_path / "f.exr")
    found = read_exr(tmp_path / "f.exr")
    expected = set()
    for name, image in frame.aovs().items():
        prefix = f"{name}." if name else ""
        expected |= {prefix + channel for channel in ("V" if image.ndim == 2 else "RGB")}
    assert {*found} == expected
    assert {"R", "composite.R", "path-traced.G", "splat.B", "fusion.traced.V", "depth.V"} <= expected
    for index, channel in enumerate("RGB"):
        np.testing.assert_array_equal(found[channel], frame.composite[..., index])
        np.testing.assert_array_equal(found[f"splat.{channel}"], renderer.splats(frame.settings)[..., index])
    np.testing.assert_array_equal(found["weight.V"], frame.weight_image())
    np.testing.assert_allclose(found["weight.V"], frame.region.weight_image(), atol=1e-5)
    np.testing.assert_array_equal(found["depth.V"], renderer.depth(frame.camera))


def test_the_splats_in_the_file_are_those_of_the_frames_layers(renderer):
    camera = renderer.scene.camera.resized(40, 30)
    coarse = renderer.frame(FrameSettings(layers=(1, 1), spp=1, camera=camera, aovs=("splat",)))
    np.testing.assert_array_equal(coarse.aovs()["splat"], renderer.splats(coarse.settings))
    fine = renderer.splats(replace(coarse.settings, layers=None))
    assert not np.array_equal(coarse.aovs()["splat"], fine)
    assert "depth" not in coarse.aovs()


def test_a_saved_frame_needs_no_renderer(renderer, tmp_path):
    """A value: what its settings do not ask for is not in the file, and nothing is rendered for it."""
    camera = renderer.scene.camera.resized(40, 30)
    renderer.frame(FrameSettings(spp=1, camera=camera)).save(tmp_path / "f.exr")
    assert not {"splat.R", "depth.V"} & {*read_exr(tmp_path / "f.exr")}


def test_only_known_aovs_are_rendered():
    with pytest.raises(UserError, match="aovs normal: must be of splat, depth"):
        FrameSettings(aovs=("depth", "normal"))


def test_the_png_file_holds_the_composite_in_srgb(frame, tmp_path):
    frame.save(str(tmp_path / "f.PNG"))
    found = np.asarray(Image.open(tmp_path / "f.PNG"))
    np.testing.assert_array_equal(found, bytes_from_radiance(frame.composite))


@pytest.mark.parametrize("name", ["f.jpg", "f", "exr"])
def test_a_file_of_another_kind_is_refused_by_name(frame, tmp_path, name):
    with pytest.raises(UserError, match=f"{name}: must end in .exr or .png"):
        frame.save(tmp_path / name)
    assert not list(tmp_path.iterdir())
