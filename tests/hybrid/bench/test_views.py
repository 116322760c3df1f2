"""Views that nothing was fitted to, and their crops."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from compose.base.errors import UserError
from compose.camera.camera import Camera
from hybrid.bench.views import crops, unfitted_views

CAMERA = Camera(np.eye(4), 64, 48, 50.0, 50.0, 32.0, 24.0)


def test_crops_lie_in_the_centre_and_have_even_sides():
    found = list(crops([CAMERA], (1, 2), 0.4))
    assert [(crop.scale, crop.camera.width, crop.camera.height) for crop in found] == [
        (1, 26, 20),
        (2, 52, 38),
    ]
    for crop in found:
        # The principal point stays in the centre, and pixels get smaller with the scale.
        assert (crop.camera.cx, crop.camera.cy) == (crop.camera.width / 2, crop.camera.height / 2)
        assert crop.camera.fy == 50 * crop.scale


def test_views_with_estimates_are_left_out():
    entry = lambda estimates: SimpleNamespace(camera=CAMERA, estimates=estimates)  # noqa: E731
    frames = SimpleNamespace(folder="frames", held_out=[entry({1: "a.exr"}), entry({})])
    assert unfitted_views(frames) == [CAMERA]
    frames.held_out.pop()
    with pytest.raises(UserError, match=r"^frames: the fusion is fitted to all held-out views"):
        unfitted_views(frames)
