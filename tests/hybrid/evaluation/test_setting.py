"""A row's setting, and what of a measured row was varied."""

from __future__ import annotations

from dataclasses import replace

import pytest

from compose.fovea.foveation import FoveaMode
from hybrid.evaluation.sweep_catalogue import varied


@pytest.mark.parametrize("mode", list(FoveaMode))
def test_all_but_raw_foveas_are_denoised(base, mode):
    setting = replace(base, frame=replace(base.frame, fovea=mode))
    assert setting.is_denoised == (mode is not FoveaMode.RAW)


def test_what_comes_before_the_times_was_varied():
    row = {"width": 4, "radius": 20, "ms": {"p50": 3.0}, "ratio": 2.0}
    assert varied(row) == {"width": 4, "radius": 20}
    assert varied({"ms": {}, "ratio": 2.0}) == {}
