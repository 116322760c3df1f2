"""References of an evaluation: samples, files and errors."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.evaluation.evaluation import reference_samples, stored_reference
from hybrid.evaluation.evaluation_settings import FOVEAL_REFERENCE, EvaluationSettings
from hybrid.measure.image_metrics import regions
from hybrid.measure.reference import Reference
from hybrid.render.frame_settings import FrameSettings
from tests import small

SETTINGS = EvaluationSettings(FrameSettings((0.25, 0.5), 25, 25), width=64, height=40, reference_spp=3)


def made_up(height: int = 40, width: int = 64) -> Reference:
    rng = small.rng()
    halves = tuple(rng.uniform(0.2, 0.8, (height, width, 3)).astype(np.float32) for _ in range(2))
    errors = rng.uniform(1e-4, 2e-4, (height, width)).astype(np.float32)
    return Reference(0.5 * (halves[0] + halves[1]), halves, errors)


def test_the_disc_has_eight_times_the_samples():
    samples = reference_samples(SETTINGS).reshape(40, 64)
    assert set(samples.ravel()) == {3, 24}
    assert FOVEAL_REFERENCE == 8
    # A radius of 10 pixels around (16, 20).
    assert (samples == 24).sum() == pytest.approx(np.pi * 10**2, rel=0.03)
    assert samples[20, 7] == samples[11, 16] == 24
    assert samples[20, 27] == samples[32, 16] == 3


def test_a_reference_is_made_once_and_comes_back_as_it_was(tmp_path):
    file, made = tmp_path / "work" / "reference-0.exr", []
    file.parent.mkdir()

    def make() -> Reference:
        made.append(made_up())
        return made[-1]

    first, again = stored_reference(file, make), stored_reference(file, make)
    assert len(made) == 1
    for found in (first, again):
        np.testing.assert_array_equal(found.radiance, made[0].radiance)
        np.testing.assert_array_equal(found.errors, made[0].errors)
        for half, expected in zip(found.halves, made[0].halves, strict=True):
            np.testing.assert_array_equal(half, expected)


def test_errors_are_told_by_region():
    reference = made_up()
    reference.halves[1][...] = reference.halves[0]
    x, y = np.arange(64) + 0.5 - 16, np.arange(40) + 0.5 - 20
    reference.errors[...] = np.where(np.hypot(*np.meshgrid(x, y)) < 10, 1e-4, 1e-2)
    parts = regions(SETTINGS.frame.foveation, reference.radiance)
    psnr = {name: reference.psnr(part.mask) for name, part in parts.items()}
    assert psnr["foveal"] == pytest.approx(40)
    assert psnr["peripheral"] == pytest.approx(20)
    assert 20 < psnr["whole"] < 21
    assert "salient" in psnr
