"""Frames whose nodes are selected by the frame before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from hybrid.evaluation.last_frame import LastFrameRenderer
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.splat_renderer import SplatRenderer
from splat.model.forest import Forest, forest_of
from splat.model.gaussians import SH_DC, Gaussians
from splat.model.motion import NodeMotion
from splat.model.trees import Layer

# Looks along z at a wall of nodes in the plane z = 0.
POSE = np.eye(4)
POSE[2, 3] = 4
CAMERA = Camera(POSE, 256, 64, 64.0, 64.0, 128.0, 32.0)
SETTINGS = FrameSettings(camera=CAMERA, gaze=Gaze(0.4, 0.5), acuity_model="fov-gs")


def _layer(spacing: float, brightness: float, parents: int, moves: bool) -> Layer:
    """A wall of nodes of one colour."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-7, 7, spacing), np.arange(-2, 2, spacing)))
    count = len(x)
    means = torch.from_numpy(np.stack([x, y, np.zeros(count)])).float()
    gaussians = Gaussians(
        means,
        torch.full((3, count), float(np.log(0.5 * spacing))),
        torch.tensor([1.0, 0, 0, 0])[:, None].repeat(1, count),
        torch.full((count,), 3.0),
        torch.full((1, 3, count), (brightness - 0.5) / SH_DC),
    )
    parent = torch.zeros(count, dtype=torch.int32) if parents else torch.full((count,), -1, dtype=torch.int32)
    semantic = torch.full((count,), 0 if moves else -1, dtype=torch.int32)
    return Layer(gaussians, parent, semantic, semantic >= 0)


def _forest(shift: float) -> Forest:
    """Two layers, the coarse one dark and of one node's colour; all of it moves along x by some way."""
    times = 5
    shifts = torch.zeros(times, 1, 3, dtype=torch.float64)
    shifts[:, 0, 0] = torch.linspace(0, shift, times, dtype=torch.float64)
    rotations = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64).repeat(times, 1, 1)
    motion = NodeMotion(
        rotations, torch.zeros(1, 3, dtype=torch.float64), shifts, torch.ones(1, dtype=torch.int64)
    )
    layers = [_layer(1.0, 0.2, 0, True), _layer(0.25, 0.8, 1, True)]
    return forest_of(layers, 64.0, "wall", "0" * 64, motion=motion)


def test_the_first_frame_and_one_in_which_nothing_moves_are_as_without(backend):
    forest = _forest(0.0)
    renderer = LastFrameRenderer(forest)
    for time in (0.0, 0.5):
        settings = replace(SETTINGS, time=time)
        renderer.select(settings)
        expected = SplatRenderer(forest).frame(settings).composite
        np.testing.assert_allclose(renderer.frame(settings), expected, atol=0.01)


def test_only_nodes_near_cells_of_their_layer_are_selected(backend):
    forest = _forest(0.0)
    selected = LastFrameRenderer(forest).selected(replace(SETTINGS, gaze=Gaze(0.1, 0.5)))
    coarse, fine = np.split(selected, np.cumsum(forest.counts)[:1])
    assert 0 < fine.sum() < len(fine)
    assert 0 < coarse.sum() < len(coarse)
    # The gaze is on the left.
    x = forest.layers[-1].gaussians.means[0].numpy()
    assert x[fine].mean() < x[~fine].mean()


def test_what_has_moved_far_since_is_missing(backend):
    forest = _forest(3.0)
    renderer = LastFrameRenderer(forest)
    renderer.select(replace(SETTINGS, time=0.0))
    now = replace(SETTINGS, time=1.0)
    renderer.select(now)
    missed = np.abs(renderer.frame(now) - SplatRenderer(forest).frame(now).composite).mean()
    renderer.forget()
    renderer.select(now)
    found = np.abs(renderer.frame(now) - SplatRenderer(forest).frame(now).composite).mean()
    assert found < 1e-6
    assert missed > 0.001
