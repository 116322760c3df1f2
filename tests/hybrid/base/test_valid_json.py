"""Results are JSON that every reader accepts."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from compose.base.files import json_text
from tests.extremes import extreme


def strict(text: str) -> object:
    """Reads JSON as a reader does that knows no NaN and no infinity."""

    def refused(name: str) -> None:
        raise ValueError(name)

    return json.loads(text, parse_constant=refused)


@extreme(
    "JSON of results that are not finite",
    given="NaN and infinities in lists, tuples and objects, NumPy's as well",
    expected="null, which every reader accepts",
)
def test_numbers_that_are_not_finite_are_null(got):
    content = {"a": math.nan, "b": [1.5, math.inf, (-math.inf, 2)], "c": {"d": np.float64("nan")}}
    assert got(strict(json_text(content))) == {"a": None, "b": [1.5, None, [None, 2]], "c": {"d": None}}


def test_everything_else_stays_as_it_is():
    content = {"a": [1, 2.5, "NaN", None, True], "b": {"c": []}}
    assert strict(json_text(content)) == content
    assert json_text(content) == json.dumps(content, indent=1) + "\n"
    with pytest.raises(TypeError):
        json_text({"a": object()})
