"""What figures share."""

from __future__ import annotations

from xml.etree import ElementTree

from hybrid.evaluation.result_plots import add_legend_beside, add_point, new_axes, plain_ticks, svg_of


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
