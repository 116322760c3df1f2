"""Samples per pixel of the disc that is shown."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hybrid.interactive.shown import Shown


def shown(counts: list[float]) -> Shown:
    samples = SimpleNamespace(count=np.array(counts, dtype=np.float32))
    frame = SimpleNamespace(fovea=SimpleNamespace(samples=samples))
    return Shown(np.zeros((4, 4, 3), np.uint8), None, frame, 0, {}, 0, False)  # type: ignore[arg-type]


def test_samples_per_pixel_are_the_mean_over_the_disc():
    assert shown([1, 2, 6]).spp == pytest.approx(3)


def test_an_empty_disc_has_no_samples():
    assert shown([]).spp == 0
