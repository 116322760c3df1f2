"""The ways to make a fovea."""

from __future__ import annotations

import pytest

from compose.fovea.foveation import FoveaMode


def test_modes_have_the_names_that_settings_and_files_use():
    assert [FoveaMode(name) for name in ("raw", "denoised", "fused")] == list(FoveaMode)


def test_there_is_no_other_mode():
    with pytest.raises(ValueError, match="blurred"):
        FoveaMode("blurred")
