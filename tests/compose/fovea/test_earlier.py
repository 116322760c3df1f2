"""The ring of earlier views: order, numbers and viewpoints of its samples."""

from __future__ import annotations

import drjit as dr
import numpy as np

from compose.base.traced_samples import STILL, UNSTEADY, Moment
from compose.fovea.earlier_views import MOST_MOMENTS, MOST_VIEWS, EarlierViews
from compose.fovea.samples import RECORD
from tests.compose.arrays_of import PlainView


def view(number: int, size: int, time: float = 0.0) -> PlainView:
    """Samples that tell which view they belong to, and which one of it they are."""
    at = np.stack([np.full(size, number), np.arange(size), np.zeros(size)], axis=1)
    records = np.arange(size * RECORD).reshape(size, RECORD) + 1000 * number
    gloss = (np.arange(size) % 3).astype(np.uint8)
    mover = np.array([STILL, 1, 12_345, UNSTEADY], dtype=np.uint16)[(np.arange(size) + number) % 4]
    viewpoint = np.full(3, float(number))
    return PlainView(records.astype(np.float32), at.astype(np.float32), gloss, mover, viewpoint, time)


def test_samples_stand_in_the_order_in_which_they_came(arrays):
    """Sizes that wrap around the ring and make it grow in between."""
    known = EarlierViews(arrays)
    for number in range(60):
        known.add(view(number, 1 + number * 37 % 900).on(arrays))
        expected = [view(n, 1 + n * 37 % 900) for n in range(max(0, number - MOST_VIEWS + 1), number + 1)]
        index = dr.arange(arrays.plain.UInt, known.samples)
        place, records = known.places(index), known.records(index)
        position = np.stack([side.numpy() for side in place.position], axis=1)
        np.testing.assert_array_equal(position, np.concatenate([v.position for v in expected]))
        np.testing.assert_array_equal(place.gloss.numpy(), np.concatenate([v.gloss for v in expected]))
        np.testing.assert_array_equal(place.mover.numpy(), np.concatenate([v.mover for v in expected]))
        stored = np.stack([column.numpy() for column in records], axis=1)
        np.testing.assert_array_equal(stored, np.concatenate([v.records for v in expected]))
        # The number of a view leads to its viewpoint.
        np.testing.assert_array_equal(known.viewpoints[place.view.numpy()][:, 0], position[:, 0])


def test_cleared_views_are_forgotten(arrays):
    known = EarlierViews(arrays)
    known.add(view(3, 5).on(arrays))
    known.clear()
    assert known.samples == 0
    assert np.isinf(known.viewpoints).all()


def test_views_of_a_few_moments_before_are_kept(arrays):
    """Several views of one moment count as one, and those of the moment that is seen now do not count."""
    known = EarlierViews(arrays)
    for number in range(2 * MOST_MOMENTS):
        for _ in range(2):
            known.moment = Moment(0.1 * (number + 1), np.eye(4)[None, :3])
            known.add(view(number, 5, 0.1 * number).on(arrays))
    assert known.samples == 5 * 2 * MOST_MOMENTS
    assert not known.of_now().any()
    known.moment = Moment(0.1 * (2 * MOST_MOMENTS - 1), np.eye(4)[None, :3])
    assert known.of_now().sum() == 2
