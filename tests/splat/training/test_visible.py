"""What a view shows is chosen, and nothing that it shows is left out."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from compose.camera.camera import camera_from_pose
from splat.model.gaussians import Gaussians
from splat.raster.differentiable import render_differentiable, visible
from tests.splat.samples import KINDS, camera, gaussians, spheres


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("turn", [0.0, 0.4, 2.0, 3.1])
def test_the_image_is_that_of_all(arrays, kind, turn):
    g = gaussians(kind, n=400)
    pose = camera().camera_to_world.copy()
    cosine, sine = np.cos(turn), np.sin(turn)
    pose[:3, :3] = pose[:3, :3] @ np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    view = camera_from_pose(pose, 40, 36, 45.0, 48.0, 21.5, 17.5)
    index = visible(arrays, g, view)
    assert (index.diff() > 0).all()
    some = render_differentiable(arrays, g.select(index), view)
    torch.testing.assert_close(some, render_differentiable(arrays, g, view), rtol=1e-5, atol=1e-6)


def test_what_is_beside_or_behind_the_frame_is_left_out(arrays):
    """The frame spans x from -2.4 to 1.5 or so on the axis; sizes reach 3.33 deviations."""
    g = spheres([0.0, 9.0, -9.0, 9.0], [0.1, 0.1, 0.1, 5.0])
    g.means[2, 3] = 1.0
    assert visible(arrays, g, camera()).tolist() == [0, 3]
    g.means[2] = -9.0
    assert visible(arrays, g, camera()).tolist() == []


def test_numbers_that_are_not_finite_are_left_out(arrays):
    g = spheres([0.0, 0.0, float("nan"), float("inf")], [0.1, 0.1, 0.1, 0.1])
    g.log_scales[0, 1] = float("nan")
    assert visible(arrays, g, camera()).tolist()[:1] == [0]
    assert 2 not in visible(arrays, g, camera()).tolist()
    assert len(visible(arrays, Gaussians.none(1), camera())) == 0
