"""Plots of an evaluation and of sweeps."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from hybrid.evaluation import result_plots as plots
from hybrid.evaluation.result_plots import (
    Point,
    add_legend_beside,
    add_point,
    new_axes,
    pareto_optimal,
    plain_ticks,
    points_of,
    quality_over_time_plot,
    samples_plot,
    svg_of,
    sweep_plots,
)
from hybrid.evaluation.results import OURS, Key, Results
from tests.hybrid.evaluation import content, fakes


@pytest.fixture
def drawn(monkeypatch) -> list:
    """The axes that are drawn, instead of their SVG."""
    axes: list = []
    monkeypatch.setattr(plots, "svg_of", lambda one: (axes.append(one), "<svg/>")[1])
    return axes


def test_all_methods_are_points_and_the_front_is_a_line(drawn):
    assert quality_over_time_plot(Results(content.evaluation()), "foveal", "flip") == "<svg/>"
    (axes,) = drawn
    labels = axes.get_legend_handles_labels()[1]
    assert [label.split("  ")[1] for label in labels] == [
        "hybrid, fused",
        "hybrid, fused, 16 spp",
        "splats alone",
        "rmfr, tuned (equal-time)",
        "full",
    ]
    (line,) = axes.lines
    assert list(line.get_xdata()) == [2.0, 10.0, 30.0]
    assert list(line.get_ydata()) == pytest.approx([0.11, 0.10, 0.01])
    assert axes.get_xscale() == "log"
    assert axes.get_ylabel() == "FLIP, foveal"


def test_samples_are_a_line_beside_that_of_the_splats(drawn):
    assert samples_plot(Results(content.evaluation()), "jod") == "<svg/>"
    fused, splats = drawn[0].lines
    assert list(fused.get_xdata()) == [2, 16]
    assert list(fused.get_ydata()) == pytest.approx([9.0, 9.6])
    assert set(splats.get_ydata()) == {9.2}


def test_without_measurements_there_is_no_plot():
    found = content.evaluation()
    assert quality_over_time_plot(Results(found), "foveal", "lpips") is None
    assert samples_plot(Results(found), "lpips") is None
    found["quality"] = [row for row in found["quality"] if "16 spp" not in row["method"]]
    assert samples_plot(Results(found), "jod") is None


def test_a_plot_is_svg():
    assert quality_over_time_plot(Results(content.evaluation()), "whole", "ssim").startswith("<svg")


def test_ratios_are_a_line_per_combination_and_quality_is_over_time(drawn):
    assert len(sweep_plots(content.sweep())) == 4
    ratios, whole, foveal, flip = drawn
    ours, paper, crossing, one = ratios.lines
    assert list(ours.get_xdata()) == [20, 90]
    assert list(ours.get_ydata()) == pytest.approx([40 / 30, 0.4])
    assert list(paper.get_ydata()) == [1.25, 1.25]
    # Foveated Path Culling breaks even at 51 %.
    assert (list(crossing.get_xdata()), list(crossing.get_ydata())) == ([51.0], [1])
    assert set(one.get_ydata()) == {1}
    assert ratios.get_legend_handles_labels()[1] == ["spp 1", "FPC"]
    assert ratios.get_xlabel() == "radius"
    labels = [axes.get_ylabel() for axes in (whole, foveal, flip)]
    assert labels == ["FovVideoVDP, JOD, whole", "FovVideoVDP, JOD, foveal", "FLIP, foveal"]


def test_sizes_are_one_line(drawn):
    sweep_plots(content.sweep("resolution"))
    assert list(drawn[0].lines[0].get_xdata()) == ["48x32", "48x32"]
    assert drawn[0].get_xlabel() == "frame size"
    assert "this project" in drawn[0].get_legend_handles_labels()[1]


def test_quality_that_a_row_lacks_is_not_plotted(drawn):
    found = content.sweep()
    del found["rows"][1]["quality"]["foveal flip"]
    assert len(sweep_plots(found)) == 3
    for row in found["rows"]:
        del row["quality"]
    assert len(sweep_plots(found)) == 1


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


def test_a_figure_is_one_svg_element_that_repeats():
    def drawn() -> str:
        axes = new_axes()
        add_point(axes, 1, 2.0, 3.0, "a point", ours=True)
        add_legend_beside(axes)
        return svg_of(axes)

    assert ElementTree.fromstring(drawn()).tag.endswith("svg")
    # No date: the same results give the same page but for the names of its parts.
    assert "<dc:date>" not in drawn()


def test_our_points_have_another_colour_and_names_go_to_the_legend():
    axes = new_axes()
    add_point(axes, 1, 2.0, 3.0, "ours", ours=True)
    add_point(axes, 2, 4.0, 3.0, "theirs", ours=False)
    assert [text.get_text() for text in axes.texts] == ["1", "2"]
    handles, labels = axes.get_legend_handles_labels()
    assert labels == ["1  ours", "2  theirs"]
    colours = [tuple(handle.get_facecolor()[0]) for handle in handles]
    assert colours[0] != colours[1]


def test_ticks_of_a_logarithmic_axis_are_1_2_and_5():
    axes = new_axes()
    axes.set_xscale("log")
    axes.set_xlim(0.9, 60)
    plain_ticks(axes.xaxis)
    ticks = {float(tick) for tick in axes.get_xticks() if 0.9 <= tick <= 60}
    assert {1, 2, 5, 10, 20, 50} == {round(tick, 6) for tick in ticks}
