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
    np.testing.assert_array_equal(around.gathered(part), values)
    np.testing.assert_array_equal(around.scattered(part, values), part)
    assert np.count_nonzero(around.scattered(part * 0, values + 1)) == values.size


def test_pixels_need_not_be_adjacent():
    region = Foveation(Gaze(), 30, 20).region(64, 48)
    some = region.pixels[::3]
    around = Rectangle.around(some, 64, 48)
    values = np.arange(len(some), dtype=np.float32)[:, None] + 1
    scattered = around.scattered(np.zeros((*around.shape, 1), dtype=np.float32), values)
    np.testing.assert_array_equal(around.gathered(scattered), values)
    rows, columns = around.box
    np.testing.assert_array_equal(
        scattered[some // 64 - rows.start, some % 64 - columns.start, 0], values[:, 0]
    )


def test_runs_of_any_length_are_scattered_to_their_pixels():
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


def test_a_run_over_the_edge_of_the_frame_takes_whole_rows():
    """Pixels 5 to 9 of a frame 6 wide: the last of one row and the first four of the next."""
    around = Rectangle.around(np.arange(5, 10, dtype=np.uint32), 6, 4)
    assert around.box == (slice(0, 2), slice(0, 6))
    assert around.shape == (2, 6)
    assert around.count == 5
    assert around.spans == [(0, 5, 10)]


def test_the_rectangle_around_two_rows_by_hand():
    """Pixels (1, 2), (1, 3) and (2, 2) of 10 x 10 pixels: already even on both sides."""
    around = Rectangle.around(np.array([12, 13, 22], dtype=np.uint32), 10, 10)
    assert around.box == (slice(1, 3), slice(2, 4))
    assert around.shape == (2, 2)
    assert around.spans == [(0, 0, 2), (2, 2, 3)]


@pytest.mark.parametrize(
    ("pixel", "box"),
    [
        # One pixel becomes 2 x 2, downwards and to the right, but for the last row and column.
        (0, (slice(0, 2), slice(0, 2))),
        (99, (slice(8, 10), slice(8, 10))),
        (9, (slice(0, 2), slice(8, 10))),
    ],
)
def test_an_odd_side_grows_towards_the_inside_of_the_frame(pixel, box):
    assert Rectangle.around(np.array([pixel], dtype=np.uint32), 10, 10).box == box


def test_the_ground_of_scattered_values_is_left_as_it_is():
    around = Rectangle.around(np.array([12, 13, 22], dtype=np.uint32), 10, 10)
    ground = np.full((2, 2, 1), 7, dtype=np.float32)
    image = around.scattered(ground, np.array([[1.0], [2.0], [3.0]], dtype=np.float32))
    assert image[..., 0].tolist() == [[1, 2], [3, 7]]
    assert (ground == 7).all()


def test_a_crop_is_contiguous():
    around = Rectangle.around(np.array([12, 13, 22], dtype=np.uint32), 10, 10)
    image = np.arange(300, dtype=np.float32).reshape(10, 10, 3)
    part = around.crop(image)
    assert part.flags.c_contiguous
    assert part[1, 0].tolist() == [66, 67, 68]


def test_no_pixels_scatter_to_nothing():
    image = np.zeros((4, 3), dtype=np.float32)
    scatter(image, np.zeros(0, dtype=np.uint32), np.zeros((0, 3), dtype=np.float32))
    assert (image == 0).all()
