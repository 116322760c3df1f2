"""Seeds lie on the surfaces, in their colour, as flat discs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.gaussians import SH_DC
from splat.model.motion import NodeMotion
from splat.raster.projection import radiance_from_perceptual
from splat.training import initialization
from splat.training.initialization import hits_of, seed_at, seed_from_views
from tests.splat.raster.reference import rotation_matrix
from tests.splat.training.frames import SIZE, WALLS, closed_sphere, wall


def test_seeds_lie_on_the_surface_with_its_colour(arrays):
    seeds = seed_at(WALLS[0], np.arange(SIZE * SIZE), 0.6, degree=1).gaussians
    np.testing.assert_allclose(seeds.means[2].numpy(), 0, atol=1e-5)
    for channel in range(3):
        perceptual = arrays.plain.Float(0.5 + seeds.sh[0, channel] * SH_DC)
        radiance = radiance_from_perceptual(perceptual).numpy()
        np.testing.assert_allclose(radiance, WALLS[0].radiance.reshape(-1, 3)[:, channel], rtol=1e-4)
    assert (seeds.sh[1:] == 0).all()
    np.testing.assert_allclose(torch.sigmoid(seeds.opacity_logits), 0.5)


def test_a_seed_projects_to_its_pixel():
    camera = WALLS[0].camera
    pixels = np.array([0, 5, SIZE + 3, SIZE * SIZE - 1])
    seeds = seed_at(WALLS[0], pixels, 0.6, degree=0).gaussians
    position, _ = camera.project(seeds.means.T.double().numpy())
    np.testing.assert_allclose(position, [[0.5, 0.5], [5.5, 0.5], [3.5, 1.5], [31.5, 31.5]], atol=1e-4)
    # 0.6 pixels wide at its distance along the ray, and a fifth of that along the normal.
    deviation = 0.6 * WALLS[0].distance.ravel()[pixels] / camera.fy
    np.testing.assert_allclose(seeds.log_scales[:2].exp(), [deviation] * 2, rtol=1e-5)
    np.testing.assert_allclose(seeds.log_scales[2].exp(), 0.2 * deviation, rtol=1e-5)


def test_discs_face_their_normals():
    """The thin third axis, turned by the quaternion, is the normal; also for -z, and z for no normal."""
    view = closed_sphere(0.0)
    seeds = seed_at(view, np.arange(SIZE * SIZE), 0.6, degree=0).gaussians
    axes = rotation_matrix(seeds.rotations.double())[:, :, 2].numpy()
    np.testing.assert_allclose(axes, view.normal.reshape(-1, 3), atol=1e-5)
    back = seed_at(wall(0.0), np.arange(3), 0.6, degree=0).gaussians
    np.testing.assert_allclose(rotation_matrix(back.rotations)[:, :, 2], [[0, 0, -1]] * 3, atol=1e-6)
    unknown = wall(0.0)
    unknown.normal[:] = 0
    seeds = seed_at(unknown, np.arange(3), 0.6, degree=0).gaussians
    np.testing.assert_allclose(rotation_matrix(seeds.rotations), [np.eye(3)] * 3, atol=1e-6)


def test_pixels_that_hit_nothing_give_no_seed():
    empty = wall(0.0)
    empty.distance[:] = np.inf
    assert len(hits_of([empty, WALLS[1]])) == SIZE * SIZE
    assert len(seed_from_views([empty], 200, 0, np.random.default_rng(0))) == 0
    empty.distance[0, 3] = 2.0
    assert len(seed_at(empty, np.arange(10), 0.6, 0)) == 1
    assert len(seed_from_views([empty], 200, 2, np.random.default_rng(0))) == 1


def test_seeds_are_about_as_many_as_asked_for_and_no_two_are_alike():
    seeds = seed_from_views(WALLS, 200, 2, np.random.default_rng(0)).gaussians
    assert 180 <= len(seeds) <= 200
    assert seeds.degree == 2
    assert (seeds.sh[1:] == 0).all()
    assert len(np.unique(seeds.means.numpy(), axis=1).T) == len(seeds)
    assert len(seed_from_views(WALLS[:1], 5000, 0, np.random.default_rng(0))) <= SIZE * SIZE


def test_of_many_hits_some_are_looked_at(monkeypatch):
    monkeypatch.setattr(initialization, "_MOST_HITS", 300)
    hits = hits_of(WALLS, np.random.default_rng(0))
    assert len(hits) == 300
    assert len(np.unique(hits.gaussians.means.numpy(), axis=1).T) == 300


def test_few_seeds_are_wide():
    """A quarter of the seeds are about twice as wide, and all are nearly opaque."""
    widths = []
    plain = replace(WALLS[1], radiance=np.minimum(WALLS[1].radiance, 0.9))
    for count in (64, 256):
        seeds = seed_from_views([plain], count, 0, np.random.default_rng(0)).gaussians
        eye = torch.tensor(WALLS[1].camera.position, dtype=torch.float32)
        away = seeds.means.T.sub(eye).norm(dim=1)
        widths.append(float((seeds.log_scales[0].exp() / away).median()))
        torch.testing.assert_close(torch.sigmoid(seeds.opacity_logits), torch.full((len(seeds),), 0.9))
    assert widths[0] / widths[1] == pytest.approx(2, rel=0.3)
    # 1024 pixels, 64 seeds: about one per 4 x 4 pixels, with a standard deviation of 0.6 of that.
    assert widths[0] * 40 == pytest.approx(0.6 * 4, rel=0.3)


def test_seeds_of_instances_are_where_these_are_at_rest():
    """An instance that has moved by (1, 0, 0) at time 0.5: its half of the wall lies as far to the left."""
    turns = torch.zeros(3, 1, 4, dtype=torch.float64)
    turns[..., 0] = 1
    shifts = torch.tensor([[[0.0, 0, 0]], [[1.0, 0, 0]], [[2.0, 0, 0]]], dtype=torch.float64)
    motion = NodeMotion(
        turns, torch.zeros(1, 3, dtype=torch.float64), shifts, torch.ones(1, dtype=torch.int64)
    )
    instance = np.full((SIZE, SIZE), -1, dtype=np.int32)
    instance[:, SIZE // 2 :] = 0
    view = replace(WALLS[0], time=0.5, instance=instance)
    pixels = np.arange(SIZE * SIZE)
    still, seeds = seed_at(WALLS[0], pixels, 0.6, 0), seed_at(view, pixels, 0.6, 0, motion)
    moves = torch.from_numpy(instance.ravel() == 0)
    torch.testing.assert_close(seeds.dynamic, moves)
    torch.testing.assert_close(seeds.semantic, torch.from_numpy(instance.ravel()))
    moved = still.gaussians.means - seeds.gaussians.means
    torch.testing.assert_close(moved[:, moves], torch.tensor([[1.0], [0], [0]]).repeat(1, int(moves.sum())))
    assert (moved[:, ~moves] == 0).all()
