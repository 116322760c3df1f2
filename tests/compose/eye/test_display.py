"""Displays: angles of their pixels, names and files."""

from __future__ import annotations

import json

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.eye.display import DISPLAYS, Display, display_named
from compose.eye.gaze import Gaze, eccentricity_at

DESKTOP = DISPLAYS["desktop"]


def test_pixels_per_degree():
    """1920 pixels over 55 degrees: the eye is 960 / tan 27.5 = 1844.2 pixels away."""
    assert DESKTOP.focal == pytest.approx(1844.2, abs=0.1)
    assert DESKTOP.pixels_per_degree == pytest.approx(32.19, abs=0.01)


def test_the_viewer_sees_the_edges_at_half_the_field_of_view():
    viewer = DESKTOP.viewer(1920, 1080)
    edge, middle = np.array([[0.0, 540.0], [960.0, 540.0]]), Gaze()
    np.testing.assert_allclose(eccentricity_at(viewer, middle, edge), [27.5, 0], atol=1e-6)
    # The height follows: arctan(540 / 1844.2) on both sides.
    assert viewer.vertical_fov == pytest.approx(2 * 16.32, abs=0.01)


def test_a_smaller_frame_is_shown_around_the_centre():
    viewer = DESKTOP.viewer(960, 540)
    assert (viewer.cx, viewer.cy) == (480, 270)
    np.testing.assert_allclose(viewer.rays(np.array([[480.0, 270.0]])), [[0, 0, 1]])
    # arctan(480 / 1844.2), not half of 27.5 degrees.
    np.testing.assert_allclose(eccentricity_at(viewer, Gaze(), np.array([[0.0, 270.0]])), 14.589, atol=1e-3)


def test_displays_by_name():
    assert display_named("desktop") is DESKTOP
    assert Display(1920, 1080, 55.0, 200.0) == DESKTOP
    assert display_named("hmd") == Display(1440, 1700, 97.0, 100.0)


def test_a_display_from_a_file(tmp_path):
    file = tmp_path / "d.json"
    file.write_text(json.dumps({"width": 256, "height": 128, "fov": 20}))
    found = display_named(str(file))
    assert (found.width, found.height, found.luminance) == (256, 128, 200)
    assert found.pixels_per_degree == pytest.approx(12.67, abs=0.01)
    file.write_text(json.dumps({"width": 256, "height": 128, "fov": 20, "luminance": 80}))
    assert display_named(str(file)).luminance == 80


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"width": 256, "height": 256}', "must be JSON with width and height in pixels and fov in degrees"),
        ('{"width": 256, "height": 256, "fov": 0}', "display fov 0: must be a positive number"),
        ('{"width": 256, "height": 256, "fov": 180}', "display fov 180: .* less than 180"),
        ('{"width": "wide", "height": 256, "fov": 20}', "display width wide: must be a positive number"),
        ('{"width": 256, "height": -1, "fov": 20}', "display height -1: must be a positive number"),
        ('{"width": 256, "height": 256, "fov": NaN}', "display fov nan: must be a positive number"),
        ('{"width": 256, "height": 256, "fov": 20, "luminance": 0}', "display luminance 0: must be"),
        ('{"width": 256, "height": 256, "fov": 20, "curved": true}', "curved is unknown"),
        ("[1, 2]", "must be JSON .*not an object"),
        ("{", "must be JSON"),
    ],
)
def test_an_invalid_display_is_refused_by_file_and_value(tmp_path, content, said):
    file = tmp_path / "d.json"
    file.write_text(content)
    with pytest.raises(UserError, match=said) as caught:
        display_named(str(file))
    assert str(caught.value).startswith(f"display {file}: ")
    assert "\n" not in str(caught.value)


def test_an_unknown_display_is_refused_by_name():
    with pytest.raises(UserError, match=r"^display wall: must be desktop, hmd or a JSON file"):
        display_named("wall")
