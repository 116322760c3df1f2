"""The gaze, over time as well, and the eccentricity of pixels."""

from __future__ import annotations

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.display import DISPLAYS
from compose.eye.gaze import (
    AngularTrace,
    Gaze,
    GazeTrace,
    eccentricity,
    eccentricity_at,
    load_gaze_trace,
    require_within_frame,
)
from tests.conftest import REAL_DATA

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


TRACE = GazeTrace((0.0, 0.1, 0.5), (Gaze(0.1, 0.2), Gaze(0.5, 0.5), Gaze(0.9, 0.25)))


def test_the_latest_gaze_holds_until_the_next():
    assert TRACE.at(-1) == TRACE.at(0) == TRACE.at(0.0999) == Gaze(0.1, 0.2)
    assert TRACE.at(0.1) == TRACE.at(0.4999) == Gaze(0.5, 0.5)
    assert TRACE.at(0.5) == TRACE.at(99) == Gaze(0.9, 0.25)
    assert TRACE.duration == 0.5


def test_a_file_reads_back(tmp_path):
    file = tmp_path / "gaze.csv"
    TRACE.save(file)
    assert file.read_text() == (
        "seconds,x,y\n0.0000,0.100000,0.200000\n0.1000,0.500000,0.500000\n0.5000,0.900000,0.250000\n"
    )
    assert load_gaze_trace(file) == TRACE


def test_time_starts_at_the_first_row(tmp_path):
    file = tmp_path / "gaze.csv"
    file.write_text("seconds, x, y\n12.5,0.5,0.5\n13,0.25,0.75\n13,-0.5,0.5\n")
    expected = GazeTrace((0, 0.5, 0.5), (Gaze(0.5, 0.5), Gaze(0.25, 0.75), Gaze(-0.5, 0.5)))
    assert load_gaze_trace(file) == expected


def test_spreadsheets_write_byte_order_marks_and_empty_lines(tmp_path):
    file = tmp_path / "gaze.csv"
    file.write_text("seconds,x,y\r\n0,0.5,0.5\r\n\r\n0.5,0.25,0.75\r\n,,\r\n", encoding="utf-8-sig")
    assert load_gaze_trace(file) == GazeTrace((0, 0.5), (Gaze(0.5, 0.5), Gaze(0.25, 0.75)))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is not a gaze trace; its first line must be seconds,x,y"),
        ("t,x,y\n0,1,1\n", "is not a gaze trace"),
        ("seconds,x,y\n", "contains no gaze"),
        ("time_s,gaze_x_deg,gaze_y_deg\n0,90,1\n", r"line 2 is not a gaze \(0,90,1\); .* within 89 degrees"),
        ("time_s,gaze_x_deg,gaze_y_deg,saccade\n0,1,nan,0\n", "line 2 is not a gaze"),
        ("time_s,gaze_x_deg,gaze_y_deg\n0,1\n", "line 2 is not a gaze"),
        ("seconds,x,y\n0,1\n", r"line 2 is not a gaze \(0,1\)"),
        ("seconds,x,y\n0,1,1\n1,nan,0\n", "line 3 is not a gaze"),
        ("seconds,x,y\n0,1,1\nnan,1,0\n", "line 3: time nan must be a number"),
        ("seconds,x,y\n1,1,1\n0.5,0,0\n", "line 3: time 0.5 must be a number, not before the line above"),
        ("\xff\xfe", "cannot be read"),
    ],
)
def test_an_invalid_file_is_refused_by_name_and_line(tmp_path, text, said):
    file = tmp_path / "gaze.csv"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(UserError, match=said) as found:
        load_gaze_trace(file)
    assert str(file) in str(found.value)
    assert "\n" not in str(found.value)


def test_angles_fall_on_a_frame_as_the_display_shows_it(tmp_path):
    """A display of 55 degrees shows 27.5 degrees to the right at its edge."""
    file = tmp_path / "gaze.csv"
    file.write_text("time_s,gaze_x_deg,gaze_y_deg,saccade\n1.5,0,0,0\n1.6,27.5,-10,1\n1.75,-27.5,10,0\n")
    found = load_gaze_trace(file)
    assert found == AngularTrace((0, pytest.approx(0.1), 0.25), ((0, 0), (27.5, -10), (-27.5, 10)))
    trace = found.on(DISPLAYS["desktop"], 1920, 1080)
    assert trace.gazes[0] == Gaze(0.5, 0.5)
    # Half the width times tan 10 / tan 27.5 = 0.33872 lies 325.2 pixels below the middle, of 1,080.
    assert (trace.gazes[1].x, trace.gazes[1].y) == (pytest.approx(1), pytest.approx(0.80109, abs=1e-4))
    assert (trace.gazes[2].x, trace.gazes[2].y) == (pytest.approx(0), pytest.approx(0.19891, abs=1e-4))
    # A frame of half the size is shown in the middle of the display.
    assert found.on(DISPLAYS["desktop"], 960, 540).gazes[1].x == pytest.approx(1.5)
    assert TRACE.on(DISPLAYS["desktop"], 1920, 1080) == TRACE


@pytest.mark.skipif(not (REAL_DATA / "data").is_dir(), reason="no recorded gaze beside the project")
def test_gaze_recorded_in_headsets_is_read():
    for file in sorted((REAL_DATA / "data" / "eyenavgs" / "gaze").glob("*.csv")):
        trace = load_gaze_trace(file).on(DISPLAYS["hmd"], 1440, 1700)
        assert trace.duration == pytest.approx(45, abs=0.1)
        assert all(0 <= gaze.x <= 1 and 0 <= gaze.y <= 1 for gaze in trace.gazes)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(UserError, match=r"missing.csv: cannot be read"):
        load_gaze_trace(tmp_path / "missing.csv")


def test_digests_tell_traces_apart():
    same = GazeTrace((0.0, 0.1, 0.5), (Gaze(0.1, 0.2), Gaze(0.5, 0.5), Gaze(0.9, 0.25)))
    later = GazeTrace((0.0, 0.1, 0.6), TRACE.gazes)
    elsewhere = GazeTrace(TRACE.seconds, (*TRACE.gazes[:2], Gaze(0.9, 0.26)))
    assert same.digest() == TRACE.digest()
    assert len({TRACE.digest(), later.digest(), elsewhere.digest()}) == 3
    assert len(TRACE.digest()) == 16
