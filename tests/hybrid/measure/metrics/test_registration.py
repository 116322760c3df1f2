"""Shifts that are known are found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter

from hybrid.measure.image_metrics import registration_px
from tests import small


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    """(192, 160) with a deviation well above what counts as texture."""
    smooth = gaussian_filter(small.rng().normal(size=(192, 160)), 2.0, mode="wrap")
    return 0.3 + 0.1 * smooth / smooth.std()


def grey(plane: np.ndarray) -> np.ndarray:
    return np.repeat(plane[..., None], 3, axis=2).astype(np.float32)


@pytest.mark.parametrize(("shift", "distance"), [((0, 0), 0.0), ((3, -4), 5.0), ((0.5, 0), 0.5)])
def test_a_shift_is_found(texture, shift, distance):
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(texture), shift)).real
    assert registration_px(grey(moved), grey(texture)) == pytest.approx(distance, rel=0.03, abs=0.06)


def test_windows_without_texture_do_not_vote(texture):
    """Nine tenths of the reference are flat; only the rest tells the shift."""
    reference, moved = grey(texture), grey(np.roll(texture, 2, axis=1))
    reference[:, 80:] = moved[:, 80:] = 0.3
    assert registration_px(moved[:, :64], reference[:, :64]) == pytest.approx(2, abs=0.1)
    assert registration_px(moved, reference) == pytest.approx(2, abs=0.6)


def test_without_texture_nothing_is_said(texture):
    flat = np.full((128, 128, 3), 0.3, dtype=np.float32)
    assert registration_px(flat, flat) is None
    # Texture of the image alone does not count, nor that of images smaller than a window.
    assert registration_px(grey(texture)[:128, :128], flat) is None
    assert registration_px(grey(texture)[:63], grey(texture)[:63]) is None
