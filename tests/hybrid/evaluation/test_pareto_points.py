"""Methods as points, and which of them are Pareto-optimal."""

from __future__ import annotations

from hybrid.evaluation.result_plots import Point, pareto_optimal, points_of
from hybrid.evaluation.results import OURS, Key, Results
from tests.hybrid.evaluation import fakes


def names(points: list[Point]) -> list[str]:
    return [point.key.method for point in points]


def test_points_have_the_median_time_and_the_mean_over_the_views():
    points = points_of(Results(fakes.found()), "foveal", "jod")
    assert names(points) == [method for method, _ in fakes.METHODS]
    assert (points[0].milliseconds, points[0].value) == (10.0, 9.0)


def test_what_was_not_timed_or_not_measured_is_no_point():
    found = fakes.found()
    found["time"] = [row for row in found["time"] if row["method"] != "full"]
    assert "full" not in names(points_of(Results(found), "foveal", "jod"))
    assert points_of(Results(found), "seam", "jod") == []


def test_the_front_has_what_nothing_else_is_faster_and_better_than():
    points = points_of(Results(fakes.found()), "foveal", "jod")
    assert names(pareto_optimal(points, "jod")) == ["splats alone", "full"]
    errors = points_of(Results(fakes.found()), "foveal", "flip")
    assert names(pareto_optimal(errors, "flip")) == ["splats alone", OURS, "full"]
    tie = [
        Point(Key(name, "fixed"), time, value)
        for name, time, value in (("a", 1, 5), ("b", 1, 6), ("c", 2, 6))
    ]
    assert names(pareto_optimal(tie, "jod")) == ["b"]
