"""Reduced views show the same in fewer pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.image.colour import srgb_from_radiance
from splat.training.training_view import in_half_precision, pixel_footprint, reduced
from tests.extremes import extreme
from tests.splat.training.frames import SIZE, wall


def test_a_reduced_view_is_the_mean_of_its_pixels():
    full = wall(0.0)
    small = reduced(full, 4)
    assert (small.camera.width, small.camera.height) == (SIZE // 4, SIZE // 4)
    np.testing.assert_allclose(small.radiance[1, 2], full.radiance[4:8, 8:12].mean(axis=(0, 1)), rtol=1e-5)
    point = np.array([[0.1, 0.2, 0.0]])
    np.testing.assert_allclose(small.camera.project(point)[0] * 4, full.camera.project(point)[0])


def test_distances_and_normals_are_those_of_a_pixel():
    """Never a mean: it would lie between two surfaces."""
    full = wall(0.0)
    full.distance[:, :18] = np.inf
    full.normal[8:] = [1, 0, 0]
    small = reduced(full, 4)
    assert small.distance.shape == (8, 8)
    assert np.isinf(small.distance[:, :4]).all()
    # Column 4 begins at 16; its pixel is 18.
    np.testing.assert_array_equal(small.distance[:, 4], full.distance[2::4, 18])
    assert small.normal[:2].tolist() == [[[0, 0, -1]] * 8] * 2
    assert small.normal[2:].tolist() == [[[1, 0, 0]] * 8] * 6


def test_incomplete_pixels_are_cut_off():
    full = wall(0.0)
    cropped = replace(
        full,
        camera=full.camera.cropped(0, 0, 31, 30),
        radiance=full.radiance[:30, :31],
        distance=full.distance[:30, :31],
        normal=full.normal[:30, :31],
    )
    small, whole = reduced(cropped, 4), reduced(full, 4)
    assert (small.camera.width, small.camera.height) == (7, 7)
    for name in ("radiance", "distance", "normal"):
        np.testing.assert_array_equal(getattr(small, name), getattr(whole, name)[:7, :7])


def test_a_factor_of_1_changes_nothing():
    full = wall(0.0)
    assert reduced(full, 1) is full


def test_the_footprint_is_that_of_the_median_distance():
    """Focal length 40; the median ignores what was not hit."""
    full = wall(0.0)
    full.distance[:] = 2.0
    full.distance[0] = 100.0
    full.distance[1] = np.inf
    assert pixel_footprint([full]) == pytest.approx(2 / 40)
    far = replace(full, distance=np.full_like(full.distance, 8.0))
    assert pixel_footprint([full, far, far]) == pytest.approx(8 / 40)
    empty = replace(full, distance=np.full_like(full.distance, np.inf))
    assert pixel_footprint([empty]) == pytest.approx(1 / 40)


def test_half_precision_is_finer_than_a_display_of_ten_bits():
    view = wall(0.1)
    halved = in_half_precision(view)
    assert halved.radiance.dtype == halved.normal.dtype == np.float16
    seen, exact = (srgb_from_radiance(v.radiance.astype(np.float32)) for v in (halved, view))
    assert np.abs(seen - exact).max() < 0.5 / 1023
    np.testing.assert_array_equal(halved.distance, view.distance)
    assert reduced(halved, 2).radiance.dtype == np.float16


@extreme(
    "training frames in half precision",
    given="radiance 1e6, infinite and NaN",
    expected="cut at 65,504; what is not finite remains so",
)
def test_what_half_precision_does_not_hold_is_cut_there(got):
    view = wall(0.1)
    radiance = view.radiance.copy()
    radiance[0, :3] = [[1e6] * 3, [np.inf] * 3, [np.nan] * 3]
    halved = in_half_precision(replace(view, radiance=radiance))
    assert got(float(halved.radiance[0, 0, 0])) == 65504
    assert np.isinf(halved.radiance[0, 1]).all()
    assert np.isnan(halved.radiance[0, 2]).all()
    assert not halved.is_finite
    assert in_half_precision(view).is_finite
