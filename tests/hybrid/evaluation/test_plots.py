"""Plots of an evaluation."""

from __future__ import annotations

import pytest

from hybrid.evaluation import result_plots as plots
from hybrid.evaluation.result_plots import quality_over_time_plot, samples_plot
from hybrid.evaluation.results import Results
from tests.hybrid.evaluation import content


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
