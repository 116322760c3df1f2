"""Classes of gloss, and numbers of samples that differ from pixel to pixel."""

from __future__ import annotations

import numpy as np

from compose.base import traced_samples as gloss
from compose.base.traced_samples import Counts
from tests.compose.arrays_of import indices


def test_counts_know_their_sum(arrays):
    counts = Counts.of(indices(arrays, [3, 0, 5, 1]), 8)
    assert (counts.total, counts.most) == (9, 8)
    assert isinstance(counts.total, int)
    assert np.array(counts.each).tolist() == [3, 0, 5, 1]


def test_the_sum_of_many_counts_is_exact(arrays):
    """Beyond what a float32 holds exactly."""
    each = np.full(2**12 + 1, 2**13 + 1, dtype=np.uint32)
    assert Counts.of(indices(arrays, each), 2**13 + 1).total == int(each.astype(np.int64).sum()) > 2**25


def test_classes_are_plain_integers_in_ascending_order_of_gloss():
    """Kernels write them and tables are indexed by them."""
    classes = [gloss.DIFFUSE, gloss.GLOSSY, gloss.SPECULAR]
    assert classes == [0, 1, 2]
    assert all(type(one) is int for one in classes)
