"""Settings for a time or a quality, from what was measured."""

from __future__ import annotations

import pytest

from compose.base.errors import UserError
from hybrid.evaluation.measured_settings import MeasuredSettings, chosen
from hybrid.render.frame_settings import FrameSettings


def measured(*rows: tuple[float, float]) -> list[MeasuredSettings]:
    """Settings by time and quality; each differs from the others."""
    return [MeasuredSettings(FrameSettings(spp=1 + i), *row) for i, row in enumerate(rows)]


MEASURED = measured((50, 8.0), (100, 9.0), (120, 8.9), (400, 9.6))


@pytest.mark.parametrize(
    ("milliseconds", "jod", "expected"),
    [
        (130, None, 100),
        (100, None, 100),
        (99.9, None, 50),
        (1e6, None, 400),
        (None, 8.5, 100),
        (None, 9.0, 100),
        (None, 9.01, 400),
        (None, -1, 50),
        (500, 9.5, 400),
        (130, 8.95, 100),
    ],
)
def test_the_best_in_a_time_and_the_fastest_of_a_quality(milliseconds, jod, expected):
    assert chosen("jod", MEASURED, milliseconds, jod).milliseconds == expected
    assert chosen("jod", MEASURED[::-1], milliseconds, jod).milliseconds == expected


def test_without_a_target_the_best_settings_are_chosen():
    assert chosen("jod", MEASURED, None, None) is MEASURED[3]


def test_of_equally_good_settings_the_fastest_are_chosen():
    equal = measured((120, 9.0), (100, 9.0), (110, 9.0))
    for order in (equal, equal[::-1]):
        assert chosen("jod", order, 200, None).milliseconds == 100


def test_a_time_that_nothing_meets_is_refused_with_the_least_time():
    with pytest.raises(UserError, match=r"^target of 40 ms: the fastest settings take 50 ms$"):
        chosen("jod", MEASURED, 40, None)
    with pytest.raises(UserError, match=r"^target of 40 ms: the fastest settings take 50 ms$"):
        chosen("jod", MEASURED, 40, 8.0)


def test_a_quality_that_nothing_reaches_is_refused_with_the_best_one():
    with pytest.raises(UserError, match=r"^target of 9.5 JOD: the best settings in 130 ms reach 9.00$"):
        chosen("jod", MEASURED, 130, 9.5)
    with pytest.raises(UserError, match=r"^target of 9.7 JOD: the best settings reach 9.60$"):
        chosen("jod", MEASURED, None, 9.7)


def test_a_quality_in_jod_is_not_compared_with_another_metric():
    similarity = measured((50, 0.9))
    assert chosen("ssim", similarity, 60, None).quality == 0.9
    message = r"target of 0.5 JOD: quality was measured in SSIM; .*pip install.* hybrid sweep --over trade$"
    with pytest.raises(UserError, match=message):
        chosen("ssim", similarity, None, 0.5)
