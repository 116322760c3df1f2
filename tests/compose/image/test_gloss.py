"""Classes of gloss."""

from __future__ import annotations

from compose.base import traced_samples as gloss


def test_classes_are_plain_integers_in_ascending_order_of_gloss():
    """Kernels write them and tables are indexed by them."""
    classes = [gloss.DIFFUSE, gloss.GLOSSY, gloss.SPECULAR]
    assert classes == [0, 1, 2]
    assert all(type(one) is int for one in classes)
