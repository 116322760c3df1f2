"""Plots of a sweep."""

from __future__ import annotations

import pytest

from hybrid.evaluation import result_plots as module
from hybrid.evaluation.result_plots import sweep_plots
from tests.hybrid.evaluation import content


@pytest.fixture
def drawn(monkeypatch) -> list:
    """The axes that are drawn, instead of their SVG."""
    axes: list = []
    monkeypatch.setattr(module, "svg_of", lambda one: (axes.append(one), "<svg/>")[1])
    return axes


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
