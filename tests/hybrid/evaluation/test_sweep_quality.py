"""Quality of a sweep's frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import View
from compose.eye.gaze import Gaze
from hybrid.evaluation.methods import HybridMethod
from hybrid.evaluation.sweep_run import quality_of, regions_of
from hybrid.measure.image_metrics import psnr
from hybrid.measure.reference import Reference

pytestmark = pytest.mark.usefixtures("quick_metrics")


def test_regions_are_around_the_centre_whatever_the_gaze(base):
    elsewhere = replace(base, frame=replace(base.frame, gaze=Gaze(0.1, 0.1)))
    regions, others = regions_of(base), regions_of(elsewhere)
    assert list(regions) == ["whole", "foveal", "peripheral"]
    np.testing.assert_array_equal(regions["foveal"].mask, others["foveal"].mask)
    assert regions["foveal"].mask[16, 24]


def test_an_empty_seam_is_no_reason_to_refuse_and_an_empty_fovea_is(base):
    narrow = replace(base, frame=replace(base.frame, fov_a=25.0, fov_b=24.99))
    assert "foveal" in regions_of(narrow)
    tiny = replace(base, frame=replace(base.frame, fov_a=0.1, fov_b=0.05))
    with pytest.raises(UserError, match="the foveal region of this frame is empty"):
        regions_of(tiny)


def test_metrics_are_named_by_region(base, renderer):
    method = HybridMethod(renderer, base.frame)
    image = method.render(View(base.camera), Gaze(), 0).image
    truth = Reference(image + 0.05, (image, image), np.zeros(image.shape[:2], np.float32))
    found, ranges = quality_of(base, method, [truth])
    assert {"whole psnr", "foveal psnr", "peripheral psnr", "whole ssim"} <= set(found)
    assert found["whole psnr"] == pytest.approx(psnr(image, truth.radiance))
    assert ranges["whole psnr"] == (found["whole psnr"], found["whole psnr"])
    mask = regions_of(base)["peripheral"].mask
    assert found["peripheral psnr"] == pytest.approx(psnr(image, truth.radiance, mask))
