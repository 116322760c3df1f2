"""The named images of a frame's file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.fovea.foveation import FoveaMode
from compose.fusion.parents import PARENTS
from hybrid.render.frame import Frame
from hybrid.render.frame_renderer import Renderer
from hybrid.render.frame_settings import FrameSettings
from tests.compose.arrays_of import host

SETTINGS = FrameSettings(gaze=(0.3, 0.7), fov_a=40, fov_b=20, spp=2)
COMMON = {
    "", "composite", "fovea", "path-traced", "variance", "weight",
    "eccentricity", "level", "rate", "coverage",
}  # fmt: skip
SHARES = {f"fusion.{parent}" for parent in PARENTS}


def frame_of(renderer: Renderer, settings: FrameSettings) -> Frame:
    return renderer.frame(replace(settings, camera=renderer.scene.camera.resized(40, 30)))


@pytest.mark.parametrize(
    ("mode", "further"),
    [
        (FoveaMode.RAW, set()),
        (FoveaMode.DENOISED, {"denoised"}),
        (FoveaMode.FUSED, {"denoised", *SHARES}),
    ],
)
def test_each_mode_has_the_images_that_it_was_made_from(renderer, mode, further):
    found = frame_of(renderer, replace(SETTINGS, fovea=mode)).aovs()
    assert {*found} == COMMON | further
    single = {"weight", "eccentricity", "level", "rate", "coverage"}
    single |= SHARES
    for name, image in found.items():
        assert image.shape == ((30, 40) if name in single else (30, 40, 3))


def test_the_images_are_those_of_the_frame(renderer):
    frame = frame_of(renderer, SETTINGS)
    found = frame.aovs()
    pixels = frame.region.pixels
    assert found[""] is found["composite"]
    np.testing.assert_array_equal(found[""], frame.composite)
    of_disc = {
        "fovea": frame.fovea.radiance,
        "path-traced": frame.fovea.samples.radiance,
        "variance": frame.fovea.samples.variance(),
        "denoised": frame.fovea.denoised,
    }
    for name, values in of_disc.items():
        np.testing.assert_array_equal(found[name].reshape(-1, 3)[pixels], host(values))
    for index, parent in enumerate(PARENTS):
        np.testing.assert_array_equal(
            found[f"fusion.{parent}"].reshape(-1)[pixels], np.asarray(frame.fovea.weights[index])
        )
    np.testing.assert_array_equal(found["weight"].reshape(-1)[pixels], np.asarray(frame.fovea.disc.weights))
    outside = found["weight"] == 0
    for name in ("fovea", "path-traced", "variance", "denoised", "fusion.splat"):
        assert (found[name][outside] == 0).all()


def test_eccentricity_is_the_angle_from_the_gaze_on_the_display(renderer):
    frame = frame_of(renderer, SETTINGS)
    angle = frame.aovs()["eccentricity"]
    row, column = np.unravel_index(angle.argmin(), (30, 40))
    assert max(abs(row + 0.5 - 21), abs(column + 0.5 - 12)) <= 0.5
    # The desktop shows 1920 pixels across 55 degrees; near its centre a pixel is 0.0311 degrees wide.
    assert angle[20, 39] - angle[20, 20] == pytest.approx(19 * 0.0311, rel=0.01)


def test_level_and_rate_are_what_is_drawn(renderer):
    only = frame_of(renderer, replace(SETTINGS, layers=(2, 2), rate=1)).aovs()
    assert (only["level"] == 2).all()
    assert only["rate"].min() >= 1
    coarse = replace(SETTINGS, acuity_model="fov-gs", display="hmd", fov_a=20.0, fov_b=10.0)
    found = renderer.frame(replace(coarse, camera=renderer.scene.camera.resized(320, 240))).aovs()
    assert found["level"].min() < found["level"].max() <= 3
