"""Samples per pixel of the disc that is shown."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest

from compose.fovea.samples import Samples
from hybrid.base.compute_device import device_arrays
from hybrid.window.messages import ShownFrame

pytestmark = pytest.mark.usefixtures("backend")


def shown(counts: list[float]) -> ShownFrame:
    plain = device_arrays().plain
    nothing = Samples.none(device_arrays(), dr.arange(plain.UInt, len(counts)))
    samples = replace(nothing, count=plain.Float(counts))
    frame = SimpleNamespace(fovea=SimpleNamespace(samples=samples))
    return ShownFrame(np.zeros((4, 4, 3), np.uint8), None, frame, 0, {}, 0, False)  # type: ignore[arg-type]


def test_samples_per_pixel_are_the_mean_over_the_disc():
    assert shown([1, 2, 6]).spp == pytest.approx(3)


def test_an_empty_disc_has_no_samples():
    assert shown([]).spp == 0
