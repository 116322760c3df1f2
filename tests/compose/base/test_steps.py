"""Times among equal steps."""

from __future__ import annotations

import pytest

from compose.camera.camera import between_steps


@pytest.mark.parametrize(
    ("time", "count", "first", "share"),
    [
        (0.0, 2, 0, 0.0),
        (1.0, 2, 0, 1.0),
        (0.25, 2, 0, 0.25),
        (0.5, 5, 2, 0.0),
        (0.9, 5, 3, 0.6),
        (1.0, 5, 3, 1.0),
    ],
)
def test_a_time_lies_between_two_values(time, count, first, share):
    assert between_steps(time, count) == (first, pytest.approx(share))
