"""Distortion of lenses, and images without it."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import Camera
from pathtrace.dataset.posed_images import Lens, undistorted
from tests import posed
from tests.extremes import extreme

LENS = Lens((0.12, -0.05, 0.01), (0.004, -0.003), 0.3)


def test_distortion_is_that_of_opencv():
    x, y, (k1, k2, k3), (p1, p2) = 0.3, -0.2, LENS.radial, LENS.tangential
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )
    assert LENS.distorted(np.array([x]), np.array([y])) == (
        pytest.approx([expected[0]]),
        pytest.approx([expected[1]]),
    )


@pytest.mark.parametrize("lens", [LENS, Lens((-0.2, 0, 0)), Lens((0.3, 0, 0))])
def test_an_undistorted_image_shows_what_a_pinhole_camera_sees(lens):
    view = posed.camera(0, 96, 64)
    smooth = lambda rays: 0.5 + 0.3 * np.sin(6 * rays[:, 0]) * np.cos(5 * rays[:, 1])  # noqa: E731
    distorted = smooth(posed._rays_through(view, lens)).reshape(64, 96)
    camera, (image,) = undistorted(view, lens, [distorted])
    expected = smooth(camera.rays(camera.pixel_centres())).reshape(image.shape)
    # The half pixel around the border is that of the border.
    assert np.abs(image - expected)[1:-1, 1:-1].max() < 2e-3
    assert image.shape == (camera.height, camera.width)


def test_a_lens_that_spreads_the_frame_leaves_all_of_it():
    """Where distortion shrinks what is seen towards the middle, no margin is missing."""
    view = posed.camera(0)
    camera, (image,) = undistorted(view, Lens((-0.1, 0, 0)), [np.ones((view.height, view.width))])
    assert (camera.width, camera.height) == (view.width, view.height)
    assert np.allclose(image, 1)


@extreme(
    "a lens that is too strong",
    given="radial distortion of 5, -3 and 1000",
    expected="refused by name",
)
def test_a_lens_that_is_too_strong_is_refused(got):
    view = Camera(np.eye(4), 40, 30, 30.0, 30.0, 20.0, 15.0)
    for strength in (5.0, -3.0, 1000.0):
        with pytest.raises(ValueError, match="too strong for an image of 40 x 30 pixels; undistort"):
            undistorted(view, Lens((strength, 0, 0)), [np.ones((30, 40))])
    got("3 of 3 refused")
