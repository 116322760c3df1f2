"""Where samples go in their pixels."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from pathtrace.trace.film import FilmPositions, box_positions
from pathtrace.trace.lanes import Lanes
from tests import small

pytestmark = pytest.mark.usefixtures("backend")
COUNT = 500


def places(spp, taken: int = 0, pattern: int = 1) -> np.ndarray:
    """(COUNT, spp, 2) offsets in their boxes, of positions at whole numbers."""
    corner = mi.Float(np.arange(COUNT, dtype=np.float32)), mi.Float(np.full(COUNT, 7, dtype=np.float32))
    lanes = Lanes.of(COUNT, spp)
    x, y = lanes.places(FilmPositions(*corner), mi.UInt32(taken), mi.UInt32(pattern))
    used = slice(0, lanes.count)
    index = lanes.index.numpy()[used]
    offsets = np.stack([x.numpy()[used] - index, y.numpy()[used] - 7], axis=-1)
    return offsets.reshape(COUNT, -1, 2)


@pytest.mark.parametrize("spp", [2, 4, 16])
def test_every_column_and_row_of_a_box_gets_one_sample(spp):
    strata = np.sort(np.floor(places(spp) * spp), axis=1)
    assert (strata == np.arange(spp)[None, :, None]).all()


def test_later_samples_go_where_earlier_ones_left_gaps():
    both = np.concatenate([places(4), places(4, taken=4)], axis=1)
    np.testing.assert_array_equal(both, places(8))
    assert (np.sort(np.floor(both * 8), axis=1) == np.arange(8)[None, :, None]).all()


def test_first_places_are_spread_evenly_over_all_boxes():
    """Each box's first place is uniform: the estimate of any one sample is unbiased."""
    first = places(1)[:, 0]
    counts = np.histogram2d(first[:, 0], first[:, 1], bins=5, range=[[0, 1], [0, 1]])[0]
    expected = COUNT / 25
    # Chi-squared with 24 degrees of freedom: 0.999 quantile.
    assert ((counts - expected) ** 2 / expected).sum() < 51.2


def test_patterns_and_numbers_per_position_may_differ():
    assert not np.array_equal(places(2, pattern=1), places(2, pattern=2))
    counts = small.rng().integers(0, 5, COUNT)
    corner = mi.Float(np.arange(COUNT, dtype=np.float32)), mi.Float(np.full(COUNT, 7, dtype=np.float32))
    lanes = Lanes.of(COUNT, counts)
    x, _ = lanes.places(FilmPositions(*corner), mi.UInt32(0), mi.UInt32(1))
    offsets = (x.numpy() - lanes.index.numpy())[: lanes.count]
    even = places(4)[..., 0]
    np.testing.assert_array_equal(offsets, np.concatenate([even[i, :n] for i, n in enumerate(counts)]))


def test_a_sequence_that_ends_begins_anew_elsewhere():
    assert not np.array_equal(places(4), places(4, taken=4096))


def test_samples_fill_boxes_of_any_size():
    left = np.arange(COUNT, dtype=np.float32) * 3
    width = small.rng().uniform(0.25, 3, COUNT).astype(np.float32)
    boxes = box_positions(left, np.full(COUNT, 2.0), width, np.full(COUNT, 0.5))
    lanes = Lanes.of(COUNT, 4)
    x, y = lanes.places(boxes, mi.UInt32(0), mi.UInt32(1))
    index = lanes.index.numpy()[: lanes.count]
    inside = (x.numpy()[: lanes.count] - left[index]) / width[index]
    # Far from 0 float32 is coarser than narrow boxes' quarters are exact.
    quarters = np.sort(np.floor(inside.reshape(COUNT, 4) * 4 + 1e-3), axis=1)
    assert (quarters == np.arange(4)).mean() > 0.99
    assert (inside > -1e-3).all()
    assert (inside < 1 + 1e-3).all()
    assert y.numpy()[: lanes.count].min() >= 2
    assert y.numpy()[: lanes.count].max() < 2.5
