"""Film positions: pixels and boxes."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.trace.film import FilmPositions, box_positions, frame_positions, interleaved, pixel_positions
from tests import small

pytestmark = pytest.mark.usefixtures("backend")


def corners(positions: FilmPositions) -> list[tuple[float, float]]:
    return list(zip(positions.x.numpy().tolist(), positions.y.numpy().tolist(), strict=True))


def test_a_pixels_corner_is_its_column_and_row():
    positions = pixel_positions(mi.UInt32([0, 4, 5, 13]), width=5)
    assert corners(positions) == [(0, 0), (4, 0), (0, 1), (3, 2)]
    assert (positions.count, positions.width, positions.height) == (4, 1, 1)


def test_a_frame_is_all_pixels_row_by_row(tmp_path):
    from pathtrace.scene.scene import load_scene

    camera = load_scene(small.furnace()).camera.resized(3, 2)
    assert corners(frame_positions(camera)) == [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]


def test_boxes_have_sizes_of_their_own():
    left, top, width, height = np.array([[0.5, 2.25], [3, 4], [1, 2], [0.5, 8]])
    positions = box_positions(left, top, width, height)
    assert corners(positions) == [(0.5, 3), (2.25, 4)]
    assert positions.width.numpy().tolist() == [1, 2]
    assert positions.height.numpy().tolist() == [0.5, 8]


def test_channels_are_interleaved():
    found = interleaved([mi.Float([1, 2]), mi.Float([3, 4]), mi.Float([5, 6])])
    assert found.dtype == np.float32
    assert found.tolist() == [[1, 3, 5], [2, 4, 6]]
