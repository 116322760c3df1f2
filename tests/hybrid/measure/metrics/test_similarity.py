"""PSNR and SSIM together."""

from __future__ import annotations

import numpy as np

from hybrid.measure.image_metrics import psnr, quality, ssim


def test_both_metrics_stand_under_their_names():
    rng = np.random.default_rng(0)
    image, reference = (rng.uniform(0, 1, (20, 20, 3)).astype(np.float32) for _ in range(2))
    assert quality(image, reference) == {"psnr": psnr(image, reference), "ssim": ssim(image, reference)}
