"""The results of an evaluation: names, values and verdicts."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import pytest

from hybrid.evaluation.results import (
    EQUAL_RAYS,
    EQUAL_TIME,
    FIXED,
    HALVES,
    HALVES_KEY,
    OURS,
    OURS_KEY,
    Key,
    Results,
    flip_name,
    half_name,
    image_name,
    is_better,
    verdicts,
)
from tests.extremes import extreme
from tests.hybrid.evaluation import fakes
from tests.hybrid.evaluation.fakes import METHODS, found


def test_a_key_is_labelled_with_its_budget_unless_it_has_none():
    assert Key("full", FIXED).label == "full"
    assert Key("full", EQUAL_TIME).label == "full (equal-time)"
    assert Key("rmfr", EQUAL_RAYS).label == "rmfr (equal-rays)"


def test_keys_are_found_by_what_evaluation_json_has():
    assert {Key("full", FIXED): 1}["full", "fixed"] == 1
    assert tuple(OURS_KEY) == (OURS, "fixed") == ("hybrid, fused", "fixed")
    assert tuple(HALVES_KEY) == (HALVES, "fixed") == ("reference, half against half", "fixed")


def test_halves_have_names_of_their_own():
    assert half_name("flip", 1) == "flip, half 1"
    assert len({"flip", half_name("flip", 1), half_name("flip", 2), half_name("jod", 1)}) == 4


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


def test_what_is_not_ahead_comes_first_and_only_affordable_baselines_count():
    lines = verdicts(fakes.found())
    assert lines[0] == (
        "In the fovea, by FovVideoVDP, the hybrid frame (9) is not ahead of "
        "splats alone (9.2; better in 0 of 2 views)."
    )
    assert "by FovVideoVDP, the hybrid frame (9) is ahead of rmfr, tuned (8; better in 2 of 2" in lines[1]
    assert "by FLIP, the hybrid frame (0.1) is ahead of splats alone (0.11; better in 2" in lines[2]
    assert "and rmfr, tuned (0.2; better in 2 of 2 views)." in lines[2]
    assert not any("full" in line for line in lines)
    assert "in 1 of 2 views" in lines[3]
    assert (
        "By FovVideoVDP, the fused fovea is better than splats alone from 16 samples per pixel on." in lines
    )
    assert "By FLIP, the fused fovea is better than splats alone from 2 samples per pixel on." in lines


def test_what_was_not_measured_is_not_said():
    found = fakes.found()
    found["quality"] = [row for row in found["quality"] if row["metric"] != "jod"]
    assert not any("FovVideoVDP" in line for line in verdicts(found))
    found["quality"] = [row for row in found["quality"] if row["method"] != "rmfr, tuned"]
    assert not any("rmfr" in line or "RMFR" in line for line in verdicts(found))


def with_halves(
    found: dict[str, Any],
    method: str,
    metric: str,
    *values: float,
    region: str = "foveal",
    budget: str = "fixed",
) -> None:
    for number, value in enumerate(values, 1):
        key = {"view": 0, "method": method, "budget": budget, "region": region}
        found["quality"].append({**key, "metric": f"{metric}, half {number}", "value": value})


def test_what_the_halves_of_the_references_do_not_agree_on_is_open():
    found = fakes.found()
    with_halves(found, OURS, "flip", 0.10, 0.12)
    with_halves(found, "splats alone", "flip", 0.11, 0.11)
    lines = verdicts(found)
    said = (
        "by FLIP, the hybrid frame (0.1) cannot be distinguished from splats alone "
        "(0.11; better in 0 of 2 views, too close to tell in 2"
    )
    assert any(said in line for line in lines)
    assert not any("by FLIP" in line and "ahead of splats alone" in line for line in lines)
    # Where no halves were measured, the whole decides.
    assert any("by FLIP, the hybrid frame (0.1) is ahead of rmfr, tuned" in line for line in lines)


def whole_frame(ours: float, theirs: float, noise: float) -> dict[str, Any]:
    """An evaluation in which SSIM of the whole frame, in both views, is known to within some noise."""
    found = fakes.found()
    for row in found["quality"]:
        if row["metric"] == "ssim" and row["method"] in (OURS, "rmfr, tuned"):
            row["value"] = ours if row["method"] == OURS else theirs
    for sign, method, budget, value in (
        (1, OURS, "fixed", ours),
        (-1, "rmfr, tuned", "equal-time", theirs),
    ):
        halves = value + sign * noise / 2, value - sign * noise / 2
        with_halves(found, method, "ssim", *halves, region="whole", budget=budget)
    return found


@pytest.mark.parametrize(
    ("difference", "said"),
    [
        (0.02, "is ahead of; rmfr, tuned (0.9; better in 2 of 2 views)"),
        pytest.param(
            0.004,
            "cannot be distinguished from; rmfr, tuned (0.9; better in 0 of 2 views, too close to tell in 2)",
            marks=extreme(
                "a tie in SSIM of the whole frame",
                given="a difference of 0.004 where the halves of the references yield 0.009 and -0.001",
                expected="cannot be distinguished; no view counts as won",
            ),
        ),
        (
            0.0,
            "cannot be distinguished from; rmfr, tuned (0.9; better in 0 of 2 views, too close to tell in 2)",
        ),
        (-0.02, "is not ahead of; rmfr, tuned (0.9; better in 0 of 2 views)"),
    ],
)
def test_ties_are_found_in_the_whole_frame(difference, said, got):
    lines = verdicts(whole_frame(0.9 + difference, 0.9, 0.005))
    whole = [line for line in lines if line.startswith("Over the whole frame, by SSIM")]
    assert any(all(part in line for part in got(said).split("; ", 1)) for line in whole)
    rmfr = next(line for line in lines if "RMFR" in line)
    wins, ties = (2, 0) if difference == 0.02 else (0, 2 if abs(difference) < 0.01 else 0)
    assert f"in {wins} of 2 views" + (f", too close to tell in {ties}" if ties else "") + " (" in rmfr


@extreme(
    "an equal-time peer that drifted",
    given="a baseline at equal time that takes 20 % longer after the run",
    expected="marked as 20 % slower, never called equal",
)
def test_a_baseline_that_missed_equal_time_is_marked(got):
    found = fakes.found()
    for row in found["time"]:
        if row["method"] == "rmfr, tuned":
            row["over_ours"] = 1.2
    lines = verdicts(found)
    marked = "rmfr, tuned (8; better in 2 of 2 views; 20 % slower than the hybrid frame)"
    assert any(marked in line for line in lines)
    rmfr = next(line for line in lines if "RMFR" in line)
    assert "tuned and 20 % slower than the hybrid frame, in 1 of 2 views" in rmfr
    assert not any("equal time" in line for line in lines)
    got(marked)


@pytest.mark.parametrize("halves", [(0.10, 0.12), (0.12, 0.10)])
def test_either_half_may_disagree(halves):
    found = fakes.found()
    with_halves(found, OURS, "flip", *halves)
    with_halves(found, "splats alone", "flip", 0.11, 0.11)
    said = "by FLIP, the hybrid frame (0.1) cannot be distinguished from splats alone"
    assert any(said in line for line in verdicts(found))


def test_halves_that_agree_confirm_the_whole():
    found = fakes.found()
    with_halves(found, OURS, "flip", 0.09, 0.10)
    with_halves(found, "splats alone", "flip", 0.11, 0.11)
    assert any("by FLIP, the hybrid frame (0.1) is ahead of splats alone" in line for line in verdicts(found))
    assert not any("distinguished" in line for line in verdicts(found))


def test_bad_news_come_first_then_open_questions():
    found = fakes.found()
    with_halves(found, OURS, "flip", 0.10, 0.12)
    with_halves(found, "splats alone", "flip", 0.11, 0.11)
    starts = ("is not ahead of", "cannot be distinguished from", "is ahead of")
    kinds = [n for line in verdicts(found) for n, start in enumerate(starts) if f") {start}" in line]
    assert set(kinds) == {0, 1, 2}
    assert kinds == sorted(kinds)


def test_views_with_the_higher_ssim_are_counted_against_rmfr():
    assert (
        "SSIM of the whole frame is higher than that of rectangular mapping-based foveated rendering (RMFR), "
        "tuned and at equal time, in 1 of 2 views (Foveated Path Culling: 2 of 5, untuned)."
    ) in verdicts(fakes.found())


def test_one_sample_may_be_enough():
    found = fakes.found()
    for row in found["methods"]:
        if row.get("spp") == 2:
            row["spp"] = 1
    lines = verdicts(found)
    assert "By FLIP, the fused fovea is better than splats alone even at 1 sample per pixel." in lines
    assert (
        "By FovVideoVDP, the fused fovea is better than splats alone from 16 samples per pixel on." in lines
    )


def test_three_baselines_are_listed_as_in_a_sentence():
    found = fakes.found()
    found["methods"].append({"method": "enlarged", "budget": "equal-time", "rays": 0.3})
    for view in range(2):
        key = {"view": view, "method": "enlarged", "budget": "equal-time"}
        found["quality"].append({**key, "region": "foveal", "metric": "flip", "value": 0.3})
    (line,) = (line for line in verdicts(found) if "by FLIP" in line and "is ahead of" in line)
    names = [
        part.split(" (")[0] for part in line.split("is ahead of ")[1].replace(" and ", ", ").split("), ")
    ]
    assert names == ["splats alone", "rmfr, tuned", "enlarged"]
    assert line.count(" and ") == 1


def test_more_samples_that_are_worse_again_have_not_passed():
    found = fakes.found()
    found["methods"].append(
        {"method": f"{OURS}, 64 spp", "budget": "fixed", "rays": 9.0, "fovea": "fused", "spp": 64}
    )
    key = {"view": 0, "method": f"{OURS}, 64 spp", "budget": "fixed", "region": "foveal"}
    found["quality"].append({**key, "metric": "flip", "value": 0.12})
    said = "By FLIP, the fused fovea is better than splats alone at none of 2, 16 and 64 samples per pixel."
    assert said in verdicts(found)


def test_without_the_optional_metrics_the_fovea_is_compared_by_others():
    found = fakes.found()
    found["quality"] = [
        {**row, "metric": "ssim", "value": 1 - row["value"]} if row["metric"] == "flip" else row
        for row in found["quality"]
        if row["metric"] != "jod"
    ]
    assert any("In the fovea, by SSIM, the hybrid frame" in line for line in verdicts(found))


def test_splats_that_take_longer_are_not_compared_with():
    found = fakes.found()
    for row in found["time"]:
        if row["method"] == "splats alone":
            row["ms"]["p50"] = 10.5
    assert not any("ahead of splats alone" in line for line in verdicts(found))


def test_the_whole_frame_counts_as_well():
    found = fakes.found()
    for row in found["quality"]:
        if (row["method"], row["region"]) == ("splats alone", "whole"):
            row["value"] += 0.1
    assert any(
        "Over the whole frame, by SSIM, the hybrid frame (0.85) is not ahead of splats alone (0.935" in line
        for line in verdicts(found)
    )


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
