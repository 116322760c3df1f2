"""Which capture settings are refused."""

from __future__ import annotations

import pytest

from pathtrace.dataset.frame_set import CaptureSettings


@pytest.mark.parametrize("field", ["views", "width", "height", "spp", "held_out_spp"])
@pytest.mark.parametrize("value", [0, -3])
def test_counts_and_sizes_must_be_positive(field, value):
    with pytest.raises(ValueError, match=rf"^{field.replace('_', '-')} is {value}; must be positive$"):
        CaptureSettings(**{field: value})


def test_no_view_need_be_held_out():
    assert CaptureSettings(held_out=0).held_out == 0
    with pytest.raises(ValueError, match=r"^held-out is -1; must not be negative$"):
        CaptureSettings(held_out=-1)
