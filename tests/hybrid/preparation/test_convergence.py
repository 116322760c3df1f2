"""The time that frames take to converge, from what their passes brought."""

from __future__ import annotations

import pytest

from hybrid.preparation.decisions import CONVERGED_DB, GAUSSIANS, SAMPLES
from hybrid.preparation.stage_frames import VIEWS, Pass, converging_seconds, limit_of
from tests.extremes import extreme


def test_the_time_follows_from_what_doubling_the_samples_brought():
    """Two doublings brought 3 dB; the four that are left bring the rest."""
    passes = [Pass(4, CONVERGED_DB - 9, 10.0), Pass(16, CONVERGED_DB - 6, 40.0)]
    assert converging_seconds(passes) == pytest.approx(40 * 2**4)


def test_frames_that_hardly_gain_take_long_but_not_forever():
    passes = [Pass(4, CONVERGED_DB - 9, 10.0), Pass(8, CONVERGED_DB - 9.1, 20.0)]
    assert 20 * 2**18 < converging_seconds(passes) < 20 * 2**19


@extreme(
    "time to converge that nobody can tell",
    given="frames that have converged, were traced once, or have no more samples than before",
    expected="no time",
)
@pytest.mark.parametrize(
    "passes",
    [
        [],
        [Pass(4, 20.0, 10.0)],
        [Pass(4, 20.0, 10.0), Pass(4, 20.0, 12.0)],
        [Pass(4, 20.0, 10.0), Pass(8, CONVERGED_DB, 12.0)],
    ],
)
def test_no_time_is_named_where_none_is_known(passes, got):
    assert converging_seconds(passes) is None
    got("no time")


@pytest.mark.parametrize(
    ("frames", "trained", "held_out", "limit"),
    [
        # Squared errors of 1, 1.5 and 2: of the latter, half is the frames' own.
        (30.0, 28.24, 26.99, SAMPLES),
        # 0.1, 1 and 1.5.
        (40.0, 30.0, 28.24, GAUSSIANS),
        # 0.1, 0.2 and 1.
        (40.0, 36.99, 30.0, VIEWS),
        # The noise that frames do not share is smaller in the forest than in them.
        (28.4, 29.5, 27.3, SAMPLES),
    ],
)
def test_the_largest_part_of_the_squared_error_limits(frames, trained, held_out, limit):
    assert limit_of(frames, trained, held_out) == limit
