"""What the figures say in words, and which of them none other beats."""

from __future__ import annotations

from typing import Any

from hybrid.evaluation.verdicts import OURS, verdicts
from hybrid.report.trade_points import Point, frontier, points_of

METHODS = {
    (OURS, "fixed"): {"rays": 0.2, "fovea": "fused", "spp": 2},
    (f"{OURS}, 16 spp", "fixed"): {"rays": 1.6, "fovea": "fused", "spp": 16},
    ("splats alone", "fixed"): {"rays": 0.0},
    ("rmfr, tuned", "equal-time"): {"rays": 0.3},
    ("full", "fixed"): {"rays": 1.0},
}
# Foveal JOD and FLIP, and SSIM of the whole frame in two views.
VALUES = {
    (OURS, "fixed"): (9.0, 0.10, (0.90, 0.80)),
    (f"{OURS}, 16 spp", "fixed"): (9.6, 0.05, (0.95, 0.85)),
    ("splats alone", "fixed"): (9.2, 0.11, (0.88, 0.79)),
    ("rmfr, tuned", "equal-time"): (8.0, 0.20, (0.70, 0.81)),
    ("full", "fixed"): (9.9, 0.01, (0.99, 0.99)),
}


def evaluation() -> dict[str, Any]:
    quality = []
    for (method, budget), (jod, flip, ssims) in VALUES.items():
        for view in range(2):
            key = {"view": view, "method": method, "budget": budget}
            quality.append(
                {**key, "region": "foveal", "metric": "jod", "value": jod + (0.1 if view else -0.1)}
            )
            quality.append({**key, "region": "foveal", "metric": "flip", "value": flip})
            quality.append({**key, "region": "whole", "metric": "ssim", "value": ssims[view]})
    methods = [{"method": m, "budget": b, **entry} for (m, b), entry in METHODS.items()]
    times = [10.0, 40.0, 2.0, 10.0, 30.0]
    time = [{"method": m, "budget": b, "ms": {"p50": t}} for (m, b), t in zip(METHODS, times, strict=True)]
    return {"quality": quality, "methods": methods, "time": time}


def test_what_is_not_ahead_comes_first_and_only_rivals_count():
    lines = verdicts(evaluation())
    assert lines[0] == (
        "In the fovea, by FovVideoVDP, the hybrid frame (9) is not ahead of "
        "splats alone (9.2; better in 0 of 2 views)."
    )
    assert "by FovVideoVDP, the hybrid frame (9) is ahead of rmfr, tuned (8; better in 2 of 2" in lines[1]
    assert "by FLIP, the hybrid frame (0.1) is ahead of splats alone (0.11; better in 2" in lines[2]
    assert "and rmfr, tuned (0.2; better in 2 of 2 views)." in lines[2]
    assert not any("full" in line for line in lines)
    assert "in 1 of 2 views" in lines[3]
    assert "By FovVideoVDP the fused fovea is better than splats alone from 16 samples per pixel on." in lines
    assert "By FLIP the fused fovea is better than splats alone from 2 samples per pixel on." in lines


def test_what_was_not_measured_is_not_said():
    found = evaluation()
    found["quality"] = [row for row in found["quality"] if row["metric"] != "jod"]
    assert not any("FovVideoVDP" in line for line in verdicts(found))
    found["quality"] = [row for row in found["quality"] if row["method"] != "rmfr, tuned"]
    assert not any("rmfr" in line or "RMFR" in line for line in verdicts(found))


def test_the_frontier_has_what_nothing_else_is_faster_and_better_than():
    points = points_of(evaluation(), "foveal", "jod")
    assert [p.method for p in frontier(points, "jod")] == ["splats alone", "full"]
    errors = points_of(evaluation(), "foveal", "flip")
    assert [p.method for p in frontier(errors, "flip")] == ["splats alone", OURS, "full"]
    tie = [Point("a", "fixed", 1.0, 5.0), Point("b", "fixed", 1.0, 6.0), Point("c", "fixed", 2.0, 6.0)]
    assert [p.method for p in frontier(tie, "jod")] == ["b"]


def with_halves(found: dict[str, Any], method: str, metric: str, *values: float) -> None:
    for number, value in enumerate(values, 1):
        key = {"view": 0, "method": method, "budget": "fixed", "region": "foveal"}
        found["quality"].append({**key, "metric": f"{metric}, half {number}", "value": value})


def test_what_the_halves_of_the_references_do_not_agree_on_is_open():
    found = evaluation()
    with_halves(found, OURS, "flip", 0.10, 0.12)
    with_halves(found, "splats alone", "flip", 0.11, 0.11)
    lines = verdicts(found)
    said = "by FLIP, the hybrid frame (0.1) cannot be told apart from splats alone (0.11; better in 2 of 2"
    assert any(said in line for line in lines)
    assert not any("by FLIP" in line and "ahead of splats alone" in line for line in lines)
    # What was not measured is not there either.
    assert any("by FLIP, the hybrid frame (0.1) is ahead of rmfr, tuned" in line for line in lines)


def test_more_samples_that_are_worse_again_have_not_passed():
    found = evaluation()
    found["methods"].append(
        {"method": f"{OURS}, 64 spp", "budget": "fixed", "rays": 9.0, "fovea": "fused", "spp": 64}
    )
    key = {"view": 0, "method": f"{OURS}, 64 spp", "budget": "fixed", "region": "foveal"}
    found["quality"].append({**key, "metric": "flip", "value": 0.12})
    said = "By FLIP the fused fovea is better than splats alone at none of 2, 16 and 64 samples per pixel."
    assert said in verdicts(found)


def test_without_the_optional_metrics_others_judge_the_fovea():
    found = evaluation()
    found["quality"] = [
        {**row, "metric": "ssim", "value": 1 - row["value"]} if row["metric"] == "flip" else row
        for row in found["quality"]
        if row["metric"] != "jod"
    ]
    assert any("In the fovea, by SSIM, the hybrid frame" in line for line in verdicts(found))


def test_gaussians_that_take_longer_are_no_rivals():
    found = evaluation()
    for row in found["time"]:
        if row["method"] == "splats alone":
            row["ms"]["p50"] = 10.5
    assert not any("ahead of splats alone" in line for line in verdicts(found))


def test_the_whole_frame_counts_as_well():
    found = evaluation()
    for row in found["quality"]:
        if (row["method"], row["region"]) == ("splats alone", "whole"):
            row["value"] += 0.1
    assert any(
        "Over the whole frame, by SSIM, the hybrid frame (0.85) is not ahead of splats alone (0.935" in line
        for line in verdicts(found)
    )
