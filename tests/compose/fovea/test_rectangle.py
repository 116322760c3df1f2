"""A disc's pixels as an image and back."""

from __future__ import annotations

import numpy as np
import pytest

from compose.eye.gaze import Gaze
from compose.fovea.rectangle import Rectangle, scatter
from compose.fovea.region import Foveation
from tests import small


@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0.05, 0.9), Gaze(0.3, 0.45)])
def test_values_go_where_their_pixels_are_and_come_back(gaze):
    region = Foveation(gaze, 30, 20).region(64, 48)
    image = small.rng().uniform(0, 1, (48, 64, 3)).astype(np.float32)
    around = region.rectangle
    values = image.reshape(-1, 3)[region.pixels]
    part = around.crop(image)
    np.testing.assert_array_equal(around.taken(part), values)
    np.testing.assert_array_equal(around.scattered(part, values), part)
    assert np.count_nonzero(around.scattered(part * 0, values + 1)) == values.size


def test_pixels_need_not_lie_side_by_side():
    region = Foveation(Gaze(), 30, 20).region(64, 48)
    some = region.pixels[::3]
    around = Rectangle.around(some, 64, 48)
    values = np.arange(len(some), dtype=np.float32)[:, None] + 1
    scattered = around.scattered(np.zeros((*around.shape, 1), dtype=np.float32), values)
    np.testing.assert_array_equal(around.taken(scattered), values)
    rows, columns = around.box
    np.testing.assert_array_equal(
        scattered[some // 64 - rows.start, some % 64 - columns.start, 0], values[:, 0]
    )


def test_runs_of_any_length_are_laid_where_their_pixels_are():
    rng = small.rng()
    # Many single pixels first, then long runs.
    pixels = np.flatnonzero(rng.uniform(size=4000) < np.linspace(0.2, 1.1, 4000)).astype(np.uint32)
    values = rng.uniform(size=(len(pixels), 3)).astype(np.float32)
    scattered, expected = np.zeros((2, 4000, 3), dtype=np.float32)
    scatter(scattered, pixels, values)
    expected[pixels] = values
    np.testing.assert_array_equal(scattered, expected)


@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0.05, 0.9), Gaze(0.31, 0.45)])
def test_the_sides_are_even_where_the_frame_allows_it(gaze):
    for width, height in ((64, 48), (63, 47)):
        region = Foveation(gaze, 30, 20).region(width, height)
        for side, whole in zip(region.rectangle.shape, (height, width), strict=True):
            assert side % 2 == 0 or side == whole
        mask = region.rectangle.scattered(
            np.zeros((*region.rectangle.shape, 1), dtype=np.float32),
            np.ones((len(region.pixels), 1), dtype=np.float32),
        )
        assert mask.sum() == len(region.pixels)
