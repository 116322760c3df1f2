"""Training on frames of something that moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.choices import MotionModel
from splat.model.motion import NodeMotion, posed
from splat.raster.differentiable import render_differentiable
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests.splat.training.frames import SIZE, wall

# From rest to the right, while turning by a quarter.
WAY, TURN = 1.0, np.pi / 2
CENTRE = np.array([-0.5, 0.0, -0.6])


def motion(steps: int = 9) -> NodeMotion:
    times = np.linspace(0, 1, steps)
    rotations = np.zeros((steps, 1, 4))
    rotations[:, 0, 0], rotations[:, 0, 3] = np.cos(times * TURN / 2), np.sin(times * TURN / 2)
    shifts = np.zeros((steps, 1, 3))
    shifts[:, 0, 0] = times * WAY
    centres, one = torch.from_numpy(CENTRE[None]), torch.ones(1, dtype=torch.int64)
    return NodeMotion(torch.from_numpy(rotations), centres, torch.from_numpy(shifts), one)


def scene(x: float, time: float) -> TrainingView:
    """The wall, and a card of 0.8 x 0.4 with a cross of two colours that moves in front of it."""
    view = wall(x)
    rays = view.camera.rays(view.camera.pixel_centres())
    distance = (CENTRE[2] - view.camera.position[2]) / rays[:, 2]
    points = view.camera.position + rays * distance[:, None]
    offset = points - CENTRE - [time * WAY, 0, 0]
    back = -time * TURN
    u = np.cos(back) * offset[:, 0] - np.sin(back) * offset[:, 1]
    v = np.sin(back) * offset[:, 0] + np.cos(back) * offset[:, 1]
    hit = (np.abs(u) < 0.4) & (np.abs(v) < 0.2)
    colour = np.where((u * v > 0)[:, None], [0.7, 0.1, 0.1], [0.05, 0.2, 0.7])
    shape = (SIZE, SIZE)
    return replace(
        view,
        radiance=np.where(hit[:, None], colour, view.radiance.reshape(-1, 3))
        .reshape(*shape, 3)
        .astype(np.float32),
        distance=np.where(hit, distance, view.distance.ravel()).reshape(shape).astype(np.float32),
        time=time,
        instance=np.where(hit, 0, -1).reshape(shape).astype(np.int32),
    )


TIMES = np.linspace(0, 1, 12)
VIEWS = [scene(x, time) for time, x in zip(TIMES, np.tile([-0.4, 0.1, 0.4], 4), strict=True)]
SETTINGS = TrainingSettings(iterations=200, gaussians=900, layers=2, degree=0, seed=3)


def error(arrays, trainer: Trainer, view: TrainingView, moves: bool) -> float:
    """PSNR in dB of the finest layer at a view's time, within 0..1."""
    layer, gaussians = trainer.forest()[-1], trainer.forest()[-1].gaussians
    if moves:
        gaussians = posed(gaussians, layer.semantic, motion().placed(trainer.place).at(view.time))
    image = render_differentiable(arrays, gaussians, trainer.place.camera(view.camera)).numpy()
    difference = np.clip(image, 0, 1) - np.clip(view.radiance, 0, 1)
    return float(-10 * np.log10(np.mean(difference**2)))


@pytest.fixture(scope="module")
def trained(arrays) -> Trainer:
    trainer = Trainer(arrays, VIEWS, SETTINGS, motion=motion())
    trainer.run()
    return trainer


def test_instances_are_learnt_where_they_are_at_each_time(arrays, trained):
    """At times and from places that were not trained on; without a motion, the card is a smear."""
    still = Trainer(arrays, [replace(view, time=0.0, instance=None) for view in VIEWS], SETTINGS)
    still.run()
    for x, time in ((0.0, 0.13), (-0.3, 0.5), (0.2, 0.83)):
        view = scene(x, time)
        found = error(arrays, trained, view, moves=True)
        assert found > 22
        assert found > error(arrays, still, view, moves=False) + 3


def test_trees_are_of_one_instance_each(trained):
    coarse, fine = trained.forest()
    assert 0 < int(fine.dynamic.sum()) < len(fine)
    torch.testing.assert_close(coarse.semantic[fine.parent.long()], fine.semantic)
    torch.testing.assert_close(fine.dynamic, fine.semantic >= 0)


def test_a_motion_without_instances_changes_nothing(arrays):
    settings = replace(SETTINGS, iterations=30)
    views = [replace(view, instance=None) for view in VIEWS]
    found = []
    for course in (None, motion()):
        trainer = Trainer(arrays, views, settings, motion=course)
        trainer.run()
        found.append(trainer.forest()[-1].gaussians.means)
    # What moves is shown on the host, what does not where the arrays are.
    torch.testing.assert_close(*found, rtol=0, atol=0 if arrays.device.type == "cpu" else 1e-4)


LEARNED = replace(SETTINGS, motion=MotionModel.D_GS_OF_DYNAMIC)


def test_labels_of_nodes_are_told_anew_where_a_motion_is_learned(arrays):
    """Of nodes that all begin as background, each where it was seen."""
    # More of them would hide each other from the views that tell.
    few = replace(LEARNED, gaussians=SETTINGS.gaussians // 2)
    trainer = Trainer(arrays, VIEWS, few)
    finest = trainer._layers[-1]
    seeds = finest.layer
    still = replace(
        seeds, semantic=torch.full_like(seeds.semantic, -1), dynamic=torch.zeros_like(seeds.dynamic)
    )
    finest.begin(still, few.gaussians)
    finest.separate(len(VIEWS))
    found = finest.layer.dynamic
    assert float(found[seeds.dynamic].float().mean()) > 0.7
    assert float(found[~seeds.dynamic].float().mean()) < 0.2


@pytest.mark.parametrize("label", [0, None, -1])
def test_where_everything_moves_or_nothing_labels_stay(arrays, label):
    instance = None if label is None else np.full((SIZE, SIZE), label, dtype=np.int32)
    trainer = Trainer(arrays, [replace(view, instance=instance) for view in VIEWS], LEARNED)
    before = trainer._layers[-1].layer
    trainer._layers[-1].separate(len(VIEWS))
    after = trainer._layers[-1].layer
    torch.testing.assert_close(after.semantic, before.semantic)
    torch.testing.assert_close(after.gaussians.means, before.gaussians.means)


def test_moving_nodes_that_no_view_shows_are_removed_at_last(arrays):
    """Those that a field has led behind the wall; the others stay, and the layer below hears of it."""
    trainer = Trainer(arrays, VIEWS, LEARNED)
    finest = trainer._layers[-1]
    before = finest.layer
    behind = torch.nonzero(before.dynamic)[:3, 0]
    before.gaussians.means[2, behind] += 30
    finest.begin(before, SETTINGS.gaussians)
    now = finest.separate_at_last()
    assert now is not None
    assert (now[behind] == -1).all()
    assert bool((now >= 0)[~before.dynamic].all())
    assert int((now >= 0).sum()) == len(finest.layer)
    torch.testing.assert_close(now[now >= 0], torch.arange(len(finest.layer), dtype=torch.int32))
