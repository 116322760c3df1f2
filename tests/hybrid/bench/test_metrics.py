"""Metrics of whole images, and their means."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.bench.metrics import image_metrics, means


def test_means_are_over_the_rows_that_have_a_metric():
    rows = [{"psnr": 20.0, "flip": 0.5}, {"psnr": 30.0}, {"psnr": 40.0, "flip": 0.1}]
    assert means(rows) == {"psnr": pytest.approx(30.0), "flip": pytest.approx(0.3)}


def test_a_worse_image_is_worse_by_every_metric():
    truth = np.random.default_rng(0).uniform(0, 1, (32, 32, 3)).astype(np.float32)
    near, far = (image_metrics(truth + np.float32(offset), truth) for offset in (0.02, 0.2))
    assert near["psnr"] > far["psnr"]
    assert near["ssim"] > far["ssim"]
    assert near.get("flip", 0.0) <= far.get("flip", 0.0)
    assert near.get("jod", 10.0) >= far.get("jod", 0.0)
