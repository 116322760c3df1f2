"""A disc's pixels as an image and back."""

from __future__ import annotations

import drjit as dr
import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.eye.gaze import Gaze
from compose.fovea.disc import Disc
from compose.fovea.foveation import Foveation
from tests import small
from tests.compose.arrays_of import channels, disc_of, floats, host, image_on

GAZES = [Gaze(), Gaze(0.05, 0.9), Gaze(0.3, 0.45)]


def of_pixels(arrays: Arrays, pixels: list[int], width: int = 10, height: int = 10) -> Disc:
    """A disc of pixels of a frame, with weights from 0.5 to 1."""
    weights = np.linspace(0.5, 1, len(pixels), dtype=np.float32)
    return disc_of(arrays, width, height, np.array(pixels, dtype=np.uint32), weights)


def image_of(disc: Disc, values: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """(h, w, C) image of the rectangle from values (D, C) on a ground (h, w, C)."""
    found = disc.images(channels(disc.arrays, values), channels(disc.arrays, flat(ground)))
    return host(found).reshape(ground.shape)


def flat(image: np.ndarray) -> np.ndarray:
    return image.reshape(-1, image.shape[-1])


@pytest.mark.parametrize("gaze", GAZES)
def test_values_go_where_their_pixels_are_and_come_back(arrays, gaze):
    disc = Foveation(gaze, 30, 20).region(64, 48).disc(arrays)
    image = small.rng().uniform(0, 1, (48, 64, 3)).astype(np.float32)
    pixels, values = np.array(disc.pixels), flat(image)[np.array(disc.pixels)]
    part = host(disc.of_frame(image_on(arrays, image))).reshape(*disc.shape, 3)
    np.testing.assert_array_equal(part, image[disc.box])
    np.testing.assert_array_equal(flat(part)[np.array(disc.inside)], values)
    np.testing.assert_array_equal(image_of(disc, values, part), part)
    found = image_of(disc, values + 1, part * 0)
    assert np.count_nonzero(found) == values.size
    expected = np.zeros_like(image)
    flat(expected)[pixels] = values + 1
    np.testing.assert_array_equal(found, expected[disc.box])
    np.testing.assert_array_equal(disc.frame_image(channels(arrays, values + 1)), expected)


def test_pixels_need_not_be_adjacent(arrays):
    some = Foveation(Gaze(), 30, 20).region(64, 48).pixels[::3]
    disc = of_pixels(arrays, some.tolist(), 64, 48)
    values = np.arange(len(some), dtype=np.float32)[:, None] + 1
    image = image_of(disc, values, np.zeros((*disc.shape, 1), dtype=np.float32))
    np.testing.assert_array_equal(flat(image)[np.array(disc.inside)], values)
    rows, columns = disc.box
    np.testing.assert_array_equal(image[some // 64 - rows.start, some % 64 - columns.start, 0], values[:, 0])


def test_runs_of_any_length_go_to_their_pixels(arrays):
    rng = small.rng()
    # Many single pixels first, then long runs.
    pixels = np.flatnonzero(rng.uniform(size=4000) < np.linspace(0.2, 1.1, 4000))
    values = rng.uniform(size=(len(pixels), 3)).astype(np.float32)
    expected = np.zeros((4000, 3), dtype=np.float32)
    expected[pixels] = values
    disc = of_pixels(arrays, pixels.tolist(), 80, 50)
    np.testing.assert_array_equal(flat(disc.frame_image(channels(arrays, values))), expected)


@pytest.mark.parametrize("gaze", [Gaze(), Gaze(0.05, 0.9), Gaze(0.31, 0.45)])
def test_the_sides_are_even_where_the_frame_allows_it(arrays, gaze):
    for width, height in ((64, 48), (63, 47)):
        disc = Foveation(gaze, 30, 20).region(width, height).disc(arrays)
        for side, whole in zip(disc.shape, (height, width), strict=True):
            assert side % 2 == 0 or side == whole
        inside = np.array(disc.inside)
        assert len(np.unique(inside)) == disc.count
        assert inside.max() < disc.shape[0] * disc.shape[1]


def test_pixels_over_the_edge_of_the_frame_take_whole_rows(arrays):
    """Pixels 5 to 9 of a frame 6 wide: the last of one row and the first four of the next."""
    disc = of_pixels(arrays, [5, 6, 7, 8, 9], 6, 4)
    assert disc.box == (slice(0, 2), slice(0, 6))
    assert disc.shape == (2, 6)
    assert disc.count == 5
    assert np.array(disc.inside).tolist() == [5, 6, 7, 8, 9]


def test_the_rectangle_around_two_rows_by_hand(arrays):
    """Pixels (1, 2), (1, 3) and (2, 2) of 10 x 10 pixels."""
    disc = of_pixels(arrays, [12, 13, 22])
    assert disc.box == (slice(1, 3), slice(2, 4))
    assert disc.shape == (2, 2)
    assert np.array(disc.inside).tolist() == [0, 1, 2]
    assert np.array(disc.weights).tolist() == [0.5, 0.75, 1]
    assert not disc.covers_frame


@pytest.mark.parametrize(
    ("gaze", "box"),
    [
        # One pixel becomes 2 x 2, downwards and to the right, but for the last row and column.
        (Gaze(0.05, 0.05), (slice(0, 2), slice(0, 2))),
        (Gaze(0.95, 0.95), (slice(8, 10), slice(8, 10))),
        (Gaze(0.95, 0.05), (slice(0, 2), slice(8, 10))),
    ],
)
def test_an_odd_side_grows_towards_the_inside_of_the_frame(arrays, gaze, box):
    disc = Foveation(gaze, 4, 4).region(10, 10).disc(arrays)
    assert disc.count == 1
    assert disc.box == box


def test_the_ground_of_an_image_is_left_as_it_is(arrays):
    disc, ground = of_pixels(arrays, [12, 13, 22]), floats(arrays, np.full(4, 7))
    values = floats(arrays, [1, 2, 3])
    found, infinite = disc.images([values, values], [ground, dr.inf])
    assert np.array(found).tolist() == [1, 2, 3, 7]
    assert np.array(ground).tolist() == [7] * 4
    assert np.array(infinite).tolist() == [1, 2, 3, np.inf]


@pytest.mark.parametrize("size", [1, 7, 100])
def test_discs_of_any_number_of_pixels(arrays, size):
    """Whatever lies beyond the last pixel, where a kernel's lanes are idle, does not disturb."""
    pixels = list(range(100 - size, 100))
    disc = of_pixels(arrays, pixels)
    rows, columns = disc.box
    row, column = np.divmod(pixels, 10)
    expected = (row - rows.start) * disc.shape[1] + column - columns.start
    np.testing.assert_array_equal(disc.inside, expected)


def test_an_empty_disc_has_no_rectangle_and_shows_nothing(arrays):
    for disc in (of_pixels(arrays, [], 6, 4), Foveation(Gaze(), 0, 0).region(6, 4).disc(arrays)):
        assert disc.count == 0
        assert disc.box is None
        assert not disc.covers_frame
        assert not disc.frame_image([floats(arrays, [])] * 2).any()
        assert disc.frame_image([floats(arrays, [])] * 2).shape == (4, 6, 2)
        with pytest.raises(AssertionError, match="no image"):
            _ = disc.shape


def test_one_number_for_all_pixels_becomes_an_image_of_the_frame(arrays):
    disc = of_pixels(arrays, [1, 4], 3, 2)
    assert disc.frame_image([arrays.plain.Float(5)])[..., 0].tolist() == [[0, 5, 0], [0, 5, 0]]
