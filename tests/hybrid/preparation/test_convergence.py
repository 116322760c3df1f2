"""The time that frames take to converge, from what their passes brought."""

from __future__ import annotations

import pytest

from hybrid.preparation.decisions import CONVERGED_DB
from hybrid.preparation.stage_frames import Pass, converging_seconds
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
