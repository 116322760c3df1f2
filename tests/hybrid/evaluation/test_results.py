"""Values are found in the content of evaluation.json."""

from __future__ import annotations

import pytest

from hybrid.evaluation.results import OURS, OURS_KEY, Key, Results, is_better
from tests.hybrid.evaluation.fakes import METHODS, found

RMFR = Key("rmfr, tuned", "equal-time")
SPLATS = Key("splats alone", "fixed")


def test_methods_come_in_their_order_each_once():
    content = found()
    content["methods"] += content["methods"][:2]
    assert Results(content).keys == list(METHODS)


def test_values_are_means_over_the_views_in_any_order():
    content = found()
    content["quality"].reverse()
    assert Results(content).mean(OURS_KEY, "whole", "ssim") == pytest.approx(0.85)
    assert Results(content).mean(OURS_KEY, "foveal", "jod") == pytest.approx(9.0)


def test_what_was_not_measured_has_no_mean():
    for key, region, metric in (
        (OURS_KEY, "foveal", "ssim"),
        (OURS_KEY, "seam", "jod"),
        (Key(OURS, "equal-time"), "foveal", "jod"),
        (Key("moon", "fixed"), "foveal", "jod"),
    ):
        assert Results(found()).mean(key, region, metric) is None


def test_times_are_medians():
    times = Results(found()).times
    assert times[OURS_KEY] == 10
    assert times[SPLATS] == 2


def test_fused_frames_are_told_by_their_samples():
    assert Results(found()).fused_by_spp("jod") == {2: pytest.approx(9.0), 16: pytest.approx(9.6)}
    assert Results(found()).fused_by_spp("lpips") == {2: None, 16: None}


def test_the_fovea_is_compared_by_what_is_installed():
    content = found()
    assert Results(content).foveal_metrics == ["jod", "flip"]
    without = [row for row in content["quality"] if row["metric"] != "jod"]
    assert Results({**content, "quality": without}).foveal_metrics == ["flip"]
    plain = [{**row, "metric": {"jod": "psnr", "flip": "ssim"}.get(row["metric"], "ssim")} for row in without]
    assert Results({**content, "quality": plain}).foveal_metrics == ["ssim"]


def test_better_is_more_or_less():
    assert is_better("jod", 9.1, 9.0)
    assert not is_better("jod", 9.0, 9.0)
    assert is_better("flip", 0.1, 0.2)
    assert not is_better("flip", 0.2, 0.2)


@pytest.mark.parametrize(("milliseconds", "expected"), [(2.0, True), (10.29, True), (10.31, False)])
def test_splats_are_affordable_if_they_are_no_slower(milliseconds, expected):
    """Ours take 10 ms; up to 3 % more count as equal."""
    content = found()
    for row in content["time"]:
        if row["method"] == "splats alone":
            row["ms"]["p50"] = milliseconds
    assert Results(content).affordable_baselines() == ([SPLATS, RMFR] if expected else [RMFR])


@pytest.mark.parametrize(
    ("ratio", "label"),
    [
        (1.0, "equal-time"),
        (1.03, "equal-time"),
        (0.97, "equal-time"),
        (1.04, "equal-time, missed: 4 % slower"),
        (0.8, "equal-time, missed: 20 % faster"),
    ],
)
def test_equal_time_is_not_called_equal_where_it_was_missed(ratio, label):
    content = found()
    (row,) = (row for row in content["time"] if row["method"] == RMFR.method)
    row["over_ours"] = ratio
    assert Results(content).budget_label(RMFR) == label
    # Without frames that were paired, medians are compared.
    del row["over_ours"]
    row["ms"]["p50"] = 10 * ratio
    assert Results(content).time_over_ours(RMFR) == pytest.approx(ratio)
    assert Results(content).budget_label(SPLATS) == "fixed"


def test_noise_is_half_of_what_the_halves_differ_by():
    content = found()
    for key, values in ((OURS_KEY, (0.91, 0.89)), (RMFR, (0.70, 0.72))):
        for number, value in enumerate(values, 1):
            row = {"view": 0, "method": key.method, "budget": key.budget, "region": "whole"}
            content["quality"].append({**row, "metric": f"ssim, half {number}", "value": value})
    # Differences of 0.21 and 0.17.
    assert Results(content).noise(RMFR, "whole", "ssim") == pytest.approx(0.02)
    assert Results(content).noise(SPLATS, "whole", "ssim") == 0
    # 0.90 against 0.70 in the first view, 0.80 against 0.81 in the second one.
    assert Results(content).outcomes(RMFR, "whole", "ssim") == [True, None]
    assert Results(found()).outcomes(RMFR, "whole", "ssim") == [True, False]
