"""Harmonics above the constant one are kept by those Gaussians whose radiance is seen to turn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.camera import camera_from_pose
from splat.model.forest import forest_of
from splat.model.gaussians import SH_LINEAR, Gaussians, apart
from splat.raster.differentiable import contributions, render_differentiable
from splat.training.layer_training import turning_as_nearest, turning_of, without_unseen_turning
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests.splat.training.frames import SIZE, made, pose

EYES = np.linspace(-0.6, 0.6, 7)


def wall(x: float) -> TrainingView:
    """Grey on the left at z = 0; on the right it changes with the direction that it is seen from."""
    camera = camera_from_pose(pose(x), SIZE, SIZE, 40, 40, SIZE / 2, SIZE / 2)
    rays = camera.rays(camera.pixel_centres())
    distance = 3 / rays[:, 2]
    right = (camera.position + rays * distance[:, None])[:, 0] > 0
    grey = np.where(right, 0.35 + 0.5 * rays[:, 0], 0.35)
    colour = np.repeat(grey[:, None], 3, axis=1)
    return made(camera, colour, distance, np.array([0, 0, -1], np.float32))


def two(slope: float) -> Gaussians:
    """Two Gaussians before the eyes, apart; of the first one, the radiance along x has a slope."""
    sh = torch.zeros(4, 3, 2)
    sh[3, :, 0] = -slope / SH_LINEAR
    return Gaussians(
        torch.tensor([[-0.3, 0.3], [0.0, 0.0], [0.0, 0.0]]),
        torch.full((3, 2), -2.0),
        torch.tensor([[1.0, 1], [0, 0], [0, 0], [0, 0]]),
        torch.full((2,), 2.0),
        sh,
    )


def test_mean_and_deviation_are_over_what_views_show(arrays):
    """Both are in all views, by as much, from the directions of the eyes."""
    g = two(0.1).turning(torch.tensor([True, True]))
    views = [wall(x) for x in EYES]
    mean, deviation = turning_of(arrays, g, views, lambda time: g)
    offset = g.means[:1, 0].numpy() - EYES
    along = 0.1 * offset / np.hypot(offset, 3)
    torch.testing.assert_close(mean[:, 0], torch.full((3,), float(along.mean())), rtol=0.05, atol=1e-3)
    assert float(deviation[0]) == pytest.approx(along.std(), rel=0.05)
    assert float(deviation[1]) == 0


@pytest.mark.parametrize(("slope", "kept"), [(0.1, [0]), (0.002, [])])
def test_only_what_visibly_turns_is_kept(arrays, slope, kept):
    """What is not keeps its mean: no view changes by a step of a display."""
    g, views = two(slope), [wall(x) for x in EYES]
    found = without_unseen_turning(arrays, g, views, lambda time: g)
    assert found.directional.index.tolist() == kept
    for view in views:
        before, after = (render_differentiable(arrays, one, view.camera) for one in (g, found))
        assert float((before - after).abs().max()) < 1 / 255


def test_what_no_view_shows_is_dropped_and_finite(arrays):
    g = two(0.5)
    g.means[2] = -50.0
    found = without_unseen_turning(arrays, g, [wall(0.0)], lambda time: g)
    assert len(found.directional) == 0
    assert found.is_finite()
    assert torch.equal(found.sh[0], g.sh[0])


@pytest.fixture(scope="module")
def trained(arrays) -> Trainer:
    settings = TrainingSettings(iterations=600, gaussians=300, layers=2, degree=1)
    trainer = Trainer(arrays, [wall(x) for x in EYES], settings)
    trainer.run()
    return trainer


def test_training_keeps_them_where_the_scene_turns(arrays, trained):
    """Of what a view shows on either side, by the share that turns."""
    found = trained.forest()[-1].gaussians
    turns = torch.zeros(len(found), dtype=torch.bool).index_fill(0, found.directional.index, True)
    camera = trained.place.camera(wall(0.0).camera)
    sides = np.zeros((SIZE, SIZE, 2), np.float32)
    sides[:, : SIZE // 2 - 2, 0] = sides[:, SIZE // 2 + 2 :, 1] = 1
    shown = contributions(arrays, found, camera, sides)
    left, right = shown[turns].sum(dim=0) / shown.sum(dim=0)
    assert left < 0.2
    assert right > 0.6


def test_a_scene_that_does_not_turn_has_hardly_any(arrays):
    settings = TrainingSettings(iterations=120, gaussians=400, layers=1, degree=2)
    views = [replace(wall(x), radiance=np.full((SIZE, SIZE, 3), 0.4, np.float32)) for x in EYES]
    trainer = Trainer(arrays, views, settings)
    trainer.run()
    (layer,) = trainer.forest()
    assert layer.gaussians.degree == 2
    assert len(layer.gaussians.directional) < 0.05 * len(layer)
    state = trainer.state()[0]
    assert state["0.directional.first_moments"].shape[1] == len(layer.gaussians.directional)


def test_an_earlier_training_decides_nothing_for_a_later_one(arrays, trained):
    """What its few steps have not shown to turn may do so after all."""
    forest = forest_of(trained.forest(), 40.0, "wall", "ab" * 32, trained.place)
    again = Trainer(arrays, [wall(x) for x in EYES], trained.settings, forest)
    begun = again.state()[0]["1.directional.values"]
    assert begun.shape[1] == len(forest.finest)


def test_a_new_gaussian_may_turn_if_the_nearest_one_does():
    known = two(0.1).turning(torch.tensor([True, False]))
    new = replace(two(0.0), means=torch.tensor([[0.2, -0.4], [0.1, 0.1], [0.0, 0.0]]))
    found = turning_as_nearest(new, known)
    assert found.degree == new.degree
    assert found.directional is not None
    assert found.directional.index.tolist() == [1]
    # Nobody has told yet, or there is nothing to tell of.
    assert turning_as_nearest(new, two(0.1)) is new
    assert turning_as_nearest(new, apart(two(0.1))) is new
    assert turning_as_nearest(Gaussians.none(1), known).directional is None


def test_a_known_gaussian_that_is_not_finite_decides_nothing():
    known = two(0.1).turning(torch.tensor([True, False]))
    new = replace(two(0.0), means=torch.tensor([[0.2, -0.4], [0.1, 0.1], [0.0, 0.0]]))
    lost = replace(known, means=known.means.clone().index_fill(1, torch.tensor([0]), float("nan")))
    found = turning_as_nearest(new, lost)
    assert found.directional is not None
    assert not len(found.directional)
    nowhere = replace(known, means=torch.full_like(known.means, float("nan")))
    assert turning_as_nearest(new, nowhere) is new
