"""Times at the ends, and regions in which a metric has no value."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from hybrid.measure import frame_quality as quality
from hybrid.measure.frame_quality import Viewer, metric_rows
from hybrid.measure.frame_times import medians_by_view, percentiles, ratio_interval, ratio_of_medians
from hybrid.measure.image_metrics import plain_regions
from tests import small
from tests.extremes import extreme


@extreme(
    "percentiles of one and of no frame",
    given="one frame of 7 ms; no frame; a frame of NaN ms",
    expected="7 ms; both refused",
)
def test_one_frame_is_every_percentile_and_none_is_refused(got):
    assert got(percentiles([7.0], (50, 95, 99))) == {"p50": 7, "p95": 7, "p99": 7}
    for times in ([], [7.0, math.nan], [math.inf], [-1.0]):
        with pytest.raises(ValueError, match="must be some, all of finite times"):
            percentiles(times)


@extreme(
    "ratio to a time of zero",
    given="medians of 0, NaN or infinite ms, above and below the line, and no frames",
    expected="refused instead of an infinite speed-up",
)
def test_no_frame_takes_no_time(got):
    for times in ([0.0, 0.0, 1.0], [math.nan], [math.inf], []):
        for pair in ((times, [1.0]), ([1.0], times)):
            with pytest.raises(ValueError, match="must be positive and finite") as refused:
                ratio_of_medians(*pair)
    got(str(refused.value))
    assert ratio_of_medians([3.0], [2.0]) == 1.5


@extreme("interval of one pair", given="one frame of either method", expected="the ratio itself at both ends")
def test_one_pair_has_no_spread(got):
    assert got(ratio_interval([3.0], [2.0])) == (1.5, 1.5)


@extreme(
    "spread of one view, and of fewer frames than views",
    given="three frames of one view; two frames of three views",
    expected="one median; as many as there are frames",
)
def test_views_without_frames_have_no_median(got):
    assert got(medians_by_view([1.0, 5.0, 3.0], 1)) == [3]
    assert got(medians_by_view([1.0, 5.0], 3)) == [1, 5]


@extreme(
    "a fovea at the border of the frame",
    given="a disc of 4 px in a corner, where SSIM's window leaves the frame; a frame of 8 x 8 pixels",
    expected="all other metrics, all finite",
)
def test_metrics_without_a_value_are_left_out(monkeypatch, got):
    monkeypatch.setattr(quality, "jod", lambda *_: None)
    for size, gaze, without in ((64, Gaze(0, 0), {("foveal", "ssim")}), (8, Gaze(), None)):
        image = small.rng().uniform(0.1, 0.9, (size, size, 3)).astype(np.float32)
        parts = plain_regions(Foveation(gaze, 400 / size, 200 / size), (size, size), ("whole", "foveal"))
        rows = metric_rows(image * 1.1, image, parts, Viewer(Display(size, size, 10.0), gaze))
        found = {(row["region"], row["metric"]): row["value"] for row in rows}
        assert all(math.isfinite(value) for value in found.values())
        assert {("whole", "psnr"), ("foveal", "psnr")} <= found.keys()
        similar = {key for key in found if "ssim" in key[1]}
        assert similar == (set() if without is None else {("whole", "ssim"), ("whole", "fssim")})
        got(len(found))
