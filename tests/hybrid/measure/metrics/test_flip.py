"""FLIP: its maximum, its direction, and where it sees a defect."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from hybrid.measure import perceptual_metrics as module
from tests import small

SIZE = 80
# FLIP's own default, in pixels per degree: 3840 pixels across 0.7 m, seen from 0.7 m.
DEFAULT = np.radians(3840)


def flip_map(image, reference):
    return module.flip_map(image, reference, DEFAULT)


def flip(image, reference):
    return float(flip_map(image, reference).mean())


def hdr_flip_map(image, reference):
    return module.hdr_flip_map(image, reference, DEFAULT)


def flat(*colour: float) -> np.ndarray:
    return np.broadcast_to(np.array(colour, dtype=np.float32), (SIZE, SIZE, 3)).copy()


@pytest.fixture
def noise() -> np.ndarray:
    return small.rng().uniform(0.2, 0.8, (SIZE, SIZE, 3)).astype(np.float32)


class TestInstalled:
    @pytest.fixture(autouse=True)
    def evaluator(self):
        pytest.importorskip("flip_evaluator", reason="FLIP's evaluator is not installed")

    def test_green_against_blue_is_the_largest_error(self):
        """FLIP's colour difference is 1 for these two by definition (section 4.1 of the paper)."""
        np.testing.assert_allclose(flip_map(flat(0, 1, 0), flat(0, 0, 1)), 1, atol=1e-5)

    def test_equal_images_have_none(self, noise):
        assert flip(noise, noise) == 0
        assert not hdr_flip_map(noise, noise).any()

    def test_a_larger_difference_is_worse(self):
        errors = [flip(flat(value, value, value), flat(0.5, 0.5, 0.5)) for value in (0.5, 0.55, 0.6, 0.8)]
        assert errors[0] == 0
        assert errors == sorted(errors)
        assert errors[3] > 2 * errors[1]

    def test_it_is_seen_where_the_defect_is(self, noise):
        defect = noise.copy()
        defect[10:14, 60:64] += 0.2
        error = flip_map(defect, noise)
        assert error.shape == (SIZE, SIZE)
        assert error[10:14, 60:64].min() > 0.05
        # The filters reach 24 pixels.
        assert not error[14 + 24 :].any()
        assert not error[:, : 60 - 24].any()

    def test_the_mean_is_of_srgb_values(self):
        """Above 1 LDR-FLIP sees white; HDR-FLIP, which shows several exposures, sees a difference."""
        assert flip(flat(2, 2, 2), flat(4, 4, 4)) == 0
        assert hdr_flip_map(flat(2, 2, 2), flat(4, 4, 4)).mean() > 0.1

    def test_the_exposures_are_those_of_the_reference(self, noise):
        from flip_evaluator import evaluate

        bright = noise * 8
        expected, _, _ = evaluate(noise, bright, "HDR", inputsRGB=True, applyMagma=False)
        swapped, _, _ = evaluate(bright, noise, "HDR", inputsRGB=True, applyMagma=False)
        error = hdr_flip_map(bright, noise)
        np.testing.assert_allclose(error, np.reshape(expected, error.shape), atol=1e-6)
        assert abs(error.mean() - np.mean(swapped)) > 1e-3


def test_without_the_evaluator_there_is_no_value(monkeypatch, noise):
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert flip_map(noise, noise) is None
    assert hdr_flip_map(noise, noise) is None
