"""The results of an evaluation: names, values and times."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pytest

from hybrid.evaluation.results import (
    BEYOND,
    EQUAL_RAYS,
    EQUAL_TIME,
    FIXED,
    NEAR,
    OURS,
    OURS_KEY,
    Key,
    Results,
    flip_name,
    image_name,
    is_better,
)
from tests.hybrid.evaluation.fakes import METHODS, found, with_view


def test_a_key_is_labelled_with_its_budget_unless_it_has_none():
    assert Key("full", FIXED).label == "full"
    assert Key("full", EQUAL_TIME).label == "full (equal-time)"
    assert Key("rmfr", EQUAL_RAYS).label == "rmfr (equal-rays)"


def test_keys_are_found_by_what_evaluation_json_has():
    assert {Key("full", FIXED): 1}["full", "fixed"] == 1
    assert tuple(OURS_KEY) == (OURS, "fixed") == ("hybrid, fused", "fixed")


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


def test_seeds_of_a_view_are_averaged_first():
    """A view of two seeds counts as much as one of a single seed."""
    content = found()
    key = {"view": 0, "seed": 1, "method": OURS, "budget": "fixed", "region": "whole", "metric": "ssim"}
    content["quality"].append({**key, "value": 0.94})
    results = Results(content)
    assert results.by_view(OURS_KEY, "whole", "ssim") == {0: pytest.approx(0.92), 1: pytest.approx(0.80)}
    assert results.mean(OURS_KEY, "whole", "ssim") == pytest.approx(0.86)


def test_views_of_other_kinds_are_shown_apart():
    content = found()
    with_view(content, BEYOND, {"ssim": 0.5})
    results = Results(content)
    assert results.kinds == [NEAR, BEYOND]
    assert (results.views_of(NEAR), results.views_of(BEYOND)) == ([0, 1], [2])
    assert results.mean(OURS_KEY, "whole", "ssim") == pytest.approx(0.85)
    assert results.mean(OURS_KEY, "whole", "ssim", BEYOND) == pytest.approx(0.5)
    assert results.mean(SPLATS, "whole", "ssim", BEYOND) is None
    assert results.differences(RMFR, "whole", "ssim", BEYOND) == [pytest.approx(0.05)]


def test_differences_are_of_views_in_which_both_were_measured():
    content = found()
    differences = Results(content).differences(RMFR, "whole", "ssim")
    assert differences == [pytest.approx(0.20), pytest.approx(-0.01)]
    content["quality"] = [
        row for row in content["quality"] if (row["method"], row["view"]) != (RMFR.method, 0)
    ]
    assert Results(content).differences(RMFR, "whole", "ssim") == [pytest.approx(-0.01)]
    assert Results(content).differences(Key("moon", FIXED), "whole", "ssim") == []


def test_equal_images_have_infinite_psnr_and_no_error():
    """JSON knows no infinity: null stands for it."""
    content = found()
    for row in content["quality"]:
        if row["metric"] == "psnr" and row["view"] == 0 and row["method"] in (OURS, "full"):
            row["value"] = None
    results = Results(content)
    assert results.by_view(OURS_KEY, "whole", "psnr") == {0: np.inf, 1: 30.0}
    assert results.differences(Key("full", FIXED), "whole", "psnr") == [0.0, 0.0]
    assert results.differences(RMFR, "whole", "psnr") == [np.inf, 0.0]
    assert results.squared_error(OURS_KEY, "whole", NEAR) == pytest.approx(0.0005)
    assert results.squared_error(RMFR, "whole", NEAR) == pytest.approx(0.001)


def test_errors_of_references_are_means_over_the_views_of_a_kind():
    content = found()
    with_view(content, BEYOND, {"psnr": 30.0})
    results = Results(content)
    expected = (1e-5 + 10**-5.1) / 2
    assert results.reference_error("foveal", NEAR) == pytest.approx(expected)
    assert results.reference_error("foveal", BEYOND) == pytest.approx(1e-5)
    assert results.reference_error("seam", NEAR) is None
    content["references"][1]["psnr"] = None
    assert Results(content).reference_error("foveal", NEAR) == pytest.approx(10**-5.1 / 2)


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
    plain = [row for row in without if row["metric"] != "flip"]
    assert Results({**content, "quality": plain}).foveal_metrics == ["ssim", "psnr"]


def test_better_is_more_or_less():
    assert is_better("jod", 9.1, 9.0)
    assert not is_better("jod", 9.0, 9.0)
    assert is_better("flip", 0.1, 0.2)
    assert not is_better("flip", 0.2, 0.2)


@pytest.mark.parametrize(("milliseconds", "expected"), [(2.0, True), (10.49, True), (10.51, False)])
def test_splats_are_affordable_if_they_are_no_slower(milliseconds, expected):
    """Ours take 10 ms; up to 5 % more count as equal."""
    content = found()
    for row in content["time"]:
        if row["method"] == "splats alone":
            row["ms"]["p50"] = milliseconds
    assert Results(content).affordable_baselines() == ([SPLATS, RMFR] if expected else [RMFR])


@pytest.mark.parametrize(
    ("ratio", "label"),
    [
        (1.0, "equal-time"),
        (1.05, "equal-time"),
        (0.95, "equal-time"),
        (1.06, "equal-time, missed: 6 % slower"),
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


def test_names_stay_as_earlier_reports_have_them():
    assert image_name(0, OURS_KEY) == "0-hybrid-fused-fixed.png"
    assert (
        image_name(3, Key("rmfr, tuned for the fovea", EQUAL_TIME))
        == "3-rmfr-tuned-for-the-fovea-equal-time.png"
    )
    assert image_name(2, None) == "2-reference.png"
    assert flip_name(1, Key("3dgs, no forest", FIXED)) == "1-3dgs-no-forest-fixed-flip.png"


def test_no_two_images_have_the_same_name():
    methods = ("full", "full, denoised", "hybrid, fused", "hybrid, fused, 16 spp", "hybrid, fused, 1 spp")
    keys = [Key(*key) for key in product(methods, (FIXED, EQUAL_RAYS, EQUAL_TIME))]
    names = [name(view, key) for view in range(2) for key in keys for name in (image_name, flip_name)]
    names += [image_name(view, None) for view in range(2)]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[\w-]+\.png", name) for name in names)
