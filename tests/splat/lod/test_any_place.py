"""A forest looks the same wherever its place is, and however large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import Camera, camera_from_pose
from compose.camera.coordinate_systems import WORLD, Place
from splat.io.forest_file import load_forest, save_forest
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import forest_of
from splat.model.points import in_world
from splat.model.trees import build_forest, static_layer
from splat.raster.differentiable import render
from tests.extremes import extreme
from tests.splat.samples import camera, gaussians


def elsewhere(view: Camera, place: Place) -> Camera:
    """The camera of the world that sees a place's coordinates as `view` does."""
    pose = view.camera_to_world
    pose[:3, 3] = place.in_world(pose[:3, 3][None])[0]
    return camera_from_pose(pose, view.width, view.height, view.fx, view.fy, view.cx, view.cy)


@pytest.mark.parametrize(
    "place",
    [
        pytest.param(p, marks=extreme(f"a forest {n}", given=g, expected="the ordinary picture to 1e-3"))
        for p, n, g in [
            (Place((0.0, 0.0, 0.0), 1e-4), "in units of 1e-4", "written and read"),
            (Place((0.0, 0.0, 0.0), 1e6), "in units of 1e6", "written and read"),
            (Place((1e6, -2e6, 3e5), 1.0), "1e6 from the origin", "written and read"),
            (Place((7e3, 0.0, -5e2), 1e-5), "of 1e-5 at 7e3", "seven hundred million units away"),
        ]
    ],
)
def test_a_forest_looks_the_same_anywhere(each_arrays, place, tmp_path, got):
    layers = build_forest(static_layer(gaussians()), 0.1, 2)
    ordinary = forest_of(layers, 45.0, "", "")
    save_forest(tmp_path / "f", replace(ordinary, place=place))
    forest = load_forest(tmp_path / "f")
    assert forest.place == place
    assert forest.digest() != ordinary.digest()
    expected = ForestRenderer(each_arrays, ordinary).render_layer(camera(), 2).numpy()
    found = ForestRenderer(each_arrays, forest).render_layer(elsewhere(camera(), place), 2).numpy()
    assert expected.max() > 0.3
    assert got(float(np.abs(np.array(found) - np.array(expected)).max()), ".1e") < 1e-3


@extreme(
    "Gaussians of 1e-4 drawn by the library",
    given="`splat.render` in the place of the tiny scene",
    expected="the ordinary picture and gradient to 1e-3",
)
def test_tiny_gaussians_are_drawn_and_differentiated_in_a_place(arrays, got):
    place = Place((0.0, 0.0, 0.0), 1e-4)
    tiny, view = in_world(gaussians(), place), elsewhere(camera(), place)
    assert float(render(tiny, view).max()) == 0
    pictures, gradients = [], []
    for some, seen, where in ((gaussians(), camera(), WORLD), (tiny, view, place)):
        some.log_scales.requires_grad_()
        picture = render(some, seen, place=where)
        picture.sum().backward()
        pictures.append(picture.detach())
        gradients.append(some.log_scales.grad)
    assert got(float((pictures[0] - pictures[1]).abs().max()), ".1e") < 1e-3
    assert got(float((gradients[0] - gradients[1]).abs().max() / gradients[0].abs().max()), ".1e") < 1e-3
    assert torch.isfinite(gradients[1]).all()
