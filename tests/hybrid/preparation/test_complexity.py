"""How much there is to model, as the first frames show it."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.preparation.gaussian_count import complexity_of


def _checked(contrast: float, side: int = 16) -> np.ndarray:
    """A chess board of single pixels, half of a frame; the other half is grey."""
    image = np.full((side, side, 3), 0.25, dtype=np.float32)
    image[: side // 2, ::2] += contrast
    return image


def test_smooth_frames_have_nothing_to_model():
    assert complexity_of([_checked(0.0)]) == 0
    assert complexity_of([_checked(0.005)]) == 0


def test_what_shows_detail_counts_by_its_share_however_strong_it_is():
    half = complexity_of([_checked(0.3)])
    assert half == pytest.approx(0.5 / 0.46)
    assert complexity_of([_checked(0.6)]) == half
    assert complexity_of([_checked(0.3), _checked(0.0)]) == pytest.approx(half / 2)


def test_a_last_row_without_another_beside_it_is_left_out():
    image = _checked(0.3)
    assert complexity_of([np.vstack([image, image[:1]])]) == complexity_of([image])
