"""The gaze and the eccentricity of pixels."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze, eccentricity, eccentricity_at, require_within_frame

# Square, 110 degrees across.
FOCAL = 50 / np.tan(np.radians(55))
WIDE = Camera(np.eye(4), 100, 100, FOCAL, FOCAL, 50, 50)


def test_the_gaze_in_pixels():
    assert Gaze(0.25, 0.5).pixel(200, 100) == (50, 50)
    assert Gaze().pixel(200, 100) == (100, 50)
    assert Gaze(-0.5, 2).pixel(200, 100) == (-100, 200)


@pytest.mark.parametrize(("x", "y"), [(float("nan"), 0.5), (0.5, float("inf"))])
def test_a_gaze_that_is_not_a_number_is_refused(x, y):
    with pytest.raises(ValueError, match="finite"):
        Gaze(x, y)


@pytest.mark.parametrize(("x", "y"), [(0, 0), (1, 1), (0.3, 0.7)])
def test_a_gaze_on_the_frame_is_accepted(x, y):
    require_within_frame(x, y)


@pytest.mark.parametrize(
    ("x", "y"), [(-0.01, 0.5), (1.01, 0.5), (0.5, -0.01), (0.5, 1.01), (float("nan"), 0.5)]
)
def test_a_gaze_outside_the_frame_is_refused_by_value(x, y):
    with pytest.raises(UserError, match=f"^gaze {x} {y}: lies outside the frame; must be 0..1 each$"):
        require_within_frame(x, y)


def test_eccentricity_follows_the_great_circle():
    """The corner lies at arctan(sqrt(2) tan 55 deg) = 63.66 degrees, the opposite one twice as far."""
    corners = np.array([[0.0, 0.0], [100.0, 100.0]])
    np.testing.assert_allclose(eccentricity_at(WIDE, Gaze(), corners), 63.659, atol=1e-3)
    np.testing.assert_allclose(eccentricity_at(WIDE, Gaze(0, 0), corners), [0, 127.319], atol=1e-3)


def test_eccentricity_of_every_pixel():
    """The four pixels around the centre are half a diagonal away: arctan(sqrt(1/2) tan(55 deg) / 50)."""
    angle = eccentricity(WIDE, Gaze())
    assert angle.shape == (100, 100)
    assert angle.dtype == np.float32
    np.testing.assert_allclose(angle[49:51, 49:51], 1.1570, atol=1e-3)
    np.testing.assert_allclose(angle, angle[::-1, ::-1].T, atol=1e-4)
    assert angle[10, 90] == pytest.approx(
        eccentricity_at(WIDE, Gaze(), np.array([[90.5, 10.5]]))[0], abs=1e-4
    )


def test_eccentricity_does_not_depend_on_where_the_camera_looks():
    turned = np.array([[0.0, 0, 1, 4], [0, 1, 0, 5], [-1, 0, 0, 6], [0, 0, 0, 1]])
    other = Camera(turned, 100, 100, FOCAL, FOCAL, 50, 50)
    np.testing.assert_allclose(
        eccentricity(other, Gaze(0.2, 0.9)), eccentricity(WIDE, Gaze(0.2, 0.9)), atol=1e-4
    )


def test_tiny_angles_are_exact():
    """A millionth of a pixel at a focal length of 1000 pixels is 5.7296e-8 degrees."""
    camera = Camera(np.eye(4), 100, 100, 1000, 1000, 50, 50)
    found = eccentricity_at(camera, Gaze(), np.array([[50 + 1e-6, 50.0]]))
    np.testing.assert_allclose(found, 5.7296e-8, rtol=1e-4)
