"""Saliency: what stands out in an image."""

from __future__ import annotations

import numpy as np

from compose.eye.detail import saliency

DISCS = [(12, 12), (12, 32), (12, 52), (36, 12), (36, 32), (36, 52)]


def with_discs(odd: int, usual: list[float], other: list[float]) -> np.ndarray:
    """(48, 64, 3) grey with six discs, one of which has another colour."""
    image = np.full((48, 64, 3), 0.3, np.float32)
    y, x = np.mgrid[0:48, 0:64]
    for number, (cy, cx) in enumerate(DISCS):
        image[np.hypot(y - cy, x - cx) < 4] = other if number == odd else usual
    return image


def test_the_odd_one_out_is_salient_by_colour_alone():
    """Discs of equal intensity, one of another colour."""
    for odd in (0, 4):
        found = saliency(with_discs(odd, [0.15, 0.3, 0.45], [0.45, 0.3, 0.15]))
        assert found.min() == 0
        assert found.max() == 1
        assert int(np.argmax([found[at] for at in DISCS])) == odd


def test_the_odd_one_out_is_salient_by_brightness():
    found = saliency(with_discs(2, [0.3, 0.3, 0.3], [0.8, 0.8, 0.8]))
    peak = np.unravel_index(found.argmax(), found.shape)
    assert np.hypot(peak[0] - 12, peak[1] - 52) < 4
    assert found[36, 12] < 0.1


def test_one_object_is_one_smooth_response():
    """The blur is 4.5 % of the longer side, here 2.9 pixels: no pixel stands out from its neighbours."""
    found = saliency(with_discs(4, [0.15, 0.3, 0.45], [0.45, 0.3, 0.15]))
    assert np.abs(np.diff(found, axis=0)).max() < 0.25
    assert np.abs(np.diff(found, axis=1)).max() < 0.25


def test_a_uniform_image_draws_no_attention():
    found = saliency(np.full((10, 12, 3), 0.5, np.float32))
    assert found.shape == (10, 12)
    assert found.dtype == np.float32
    assert (found == 0).all()


def test_saliency_of_noise_does_not_change():
    """Values of this implementation, as all of its channels and the blur give them."""
    image = np.random.default_rng(0).uniform(0, 1, (24, 32, 3)).astype(np.float32)
    found = saliency(image)
    np.testing.assert_allclose(
        found[[3, 12, 20, 5], [4, 16, 30, 25]], [0.340812, 0.275183, 0.582898, 0.266194], atol=1e-5
    )
