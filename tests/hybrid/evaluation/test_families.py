"""Families of baselines: any number of rays, at the settings they are tuned to."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from compose.eye.gaze import Gaze
from hybrid.evaluation.methods import Tuning, WarpTuning, enlarged, families, warped
from tests.hybrid.evaluation.fakes import CAMERA

GAZE = Gaze(0.4, 0.55)
WIDE = CAMERA.resized(96, 64)
TUNING = Tuning(WarpTuning(0.4, 2, False), WarpTuning(0.1, 1, True), 2)


@pytest.mark.parametrize("rays", [0.2, 1.3, 2.01, 5.5])
def test_all_families_take_the_rays_that_they_are_given(rays):
    known = families(None, TUNING)
    assert list(known) == [
        "full",
        "full, denoised",
        "enlarged",
        "enlarged, denoised",
        "rmfr",
        "rmfr, tuned",
        "rmfr, tuned for the fovea",
    ]
    for name, family in known.items():
        # The cheapest full frame has one sample of each pixel, FPC's buffer one of each of its own.
        least = {"full": 1.0, "full, denoised": 1.0, "rmfr": 1 / 2.6**2}.get(name, 0.0)
        method = family(rays)
        assert method.rays(WIDE, GAZE) == pytest.approx(max(rays, least), rel=0.03), name
        # No smaller image has more pixels than the frame.
        assert getattr(method, "share", 1.0) <= 1 + 1e-9
        assert name == "rmfr" or getattr(method, "sigma", 1.0) >= 1 - 1e-9


def test_families_have_the_settings_that_their_names_promise():
    known = {name: family(0.4) for name, family in families(None, TUNING).items()}
    denoised = {name for name, method in known.items() if method.denoised}
    assert denoised == {"full, denoised", "enlarged, denoised", "rmfr, tuned for the fovea"}
    # Foveated Path Culling's own setting.
    assert (known["rmfr"].f, known["rmfr"].sigma) == (0.1, 2.6)
    assert (known["rmfr, tuned"].f, known["rmfr, tuned"].spp) == (0.4, 2)
    assert (known["rmfr, tuned for the fovea"].f, known["rmfr, tuned for the fovea"].spp) == (0.1, 1)
    assert (known["enlarged"].spp, known["enlarged, denoised"].spp) == (1, 2)


def test_settings_that_are_best_for_both_stand_once():
    same = Tuning(TUNING.frame, TUNING.frame, 2)
    assert "rmfr, tuned for the fovea" not in families(None, same)


def test_few_rays_make_images_smaller_and_many_give_them_more_samples():
    """Half a ray per pixel at 2 samples: a quarter of the pixels; 2.5 rays: 3 samples of 5 in 6 pixels."""
    small, large = (enlarged(None, 2, rays, denoised=False) for rays in (0.5, 2.5))
    assert (small.share, small.spp) == (0.25, 2)
    assert (large.share, large.spp) == (pytest.approx(2.5 / 3), 3)
    small, large = (warped(None, TUNING.frame, rays) for rays in (0.5, 2.5))
    assert (small.sigma, small.spp) == (2.0, 2)
    assert (large.sigma, large.spp) == (pytest.approx((3 / 2.5) ** 0.5), 3)


def test_a_tuning_comes_back_from_json():
    assert Tuning.restored(asdict(TUNING)) == TUNING
