"""Which capture settings are refused."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
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


def test_numbers_of_numpy_are_numbers():
    settings = CaptureSettings(views=np.int64(3), width=np.uint16(32), close_ups=(np.int32(2), 4))
    assert (settings.views, settings.width, settings.close_ups) == (3, 32, (2, 4))
    json.dumps(asdict(settings))
