"""Closed formulas of vertex positions."""

from __future__ import annotations

import numpy as np
import pytest

from pathtrace.scene.motion_file import Formula

REST = np.random.default_rng(3).normal(size=(50, 3))


def test_formulas_are_arithmetic():
    formula = Formula(("x", "y + 0.5 * sin(2 * pi * (t + x)) ** 2", "max(z, -t) / (1 + abs(x)) - cos(0)"))
    x, y, z = REST.T
    for t in (0.0, 0.3, 1.0):
        expected = [x, y + 0.5 * np.sin(2 * np.pi * (t + x)) ** 2, np.maximum(z, -t) / (1 + np.abs(x)) - 1]
        np.testing.assert_allclose(formula.positions(REST, t), np.stack(expected, axis=1), atol=1e-12)


def test_a_constant_is_the_same_for_all_vertices():
    np.testing.assert_array_equal(Formula(("1", "t", "z")).positions(REST, 0.25)[:, :2], [[1, 0.25]] * 50)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "x.real",
        "x[0]",
        "lambda: x",
        "x if t else y",
        "x < y",
        "u",
        "True",
        "'x'",
        "1j",
        "open(x)",
        "sin(x, y)",
        "sin()",
        "max(x)",
        "sin(x=1)",
        "sin(*x)",
        "x +",
        "",
        "x; y",
        "x" + " + x" * 500,
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(ValueError, match=r"formula"):
        Formula(("x", text, "z"))


@pytest.mark.parametrize(
    ("text", "time"), [("1 / (t - 0.5)", 0.5), ("sqrt(t - 1)", 0.0), ("exp(1e4 * t)", 1.0)]
)
def test_positions_must_be_finite(text, time):
    formula = Formula(("x", "y", text))
    with pytest.raises(ValueError, match=rf"no finite value for every vertex at t = {time:g}"):
        formula.positions(REST, time)
