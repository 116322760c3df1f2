"""Distances that Gaussians show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.gaussians import Gaussians
from splat.training.depth_estimates import measured
from splat.training.initialization import seed_at
from splat.training.training_view import TrainingView
from tests.splat.training.frames import SIZE, WALLS


def guessed(view: TrainingView, distance: float = 1.0) -> TrainingView:
    return replace(view, distance=np.full_like(view.distance, distance), guessed=True)


def opaque(gaussians: Gaussians, logit: float = 8.0) -> Gaussians:
    return replace(gaussians, opacity_logits=torch.full_like(gaussians.opacity_logits, logit))


def test_a_wall_of_gaussians_is_where_it_is(each_arrays):
    wall = WALLS[0]
    seeds = opaque(seed_at(wall, np.arange(SIZE * SIZE), 1.0, 1).gaussians)
    found = measured(each_arrays, seeds, guessed(wall))
    assert np.allclose(found.distance[2:-2, 2:-2], wall.distance[2:-2, 2:-2], rtol=0.03)
    assert found.guessed


def test_half_a_veil_moves_the_distance_by_its_share(each_arrays):
    """Twin in float64: the mean of distances, by the weights that alpha blending gives."""
    wall, near = WALLS[1], 0.5
    far = opaque(seed_at(wall, np.arange(SIZE * SIZE), 3.0, 0).gaussians)
    closer = replace(wall, distance=wall.distance * np.float32(near))
    alpha = 0.6
    veil = seed_at(closer, np.array([SIZE * SIZE // 2 + SIZE // 2]), 40.0, 0).gaussians
    veil = replace(veil, opacity_logits=torch.full((1,), float(np.log(alpha / (1 - alpha)))))
    both = Gaussians(
        **{name: torch.cat([tensor, dict(veil.tensors())[name]], dim=-1) for name, tensor in far.tensors()}
    )
    middle = SIZE // 2, SIZE // 2
    exact = float(wall.distance[middle]) * (alpha * near + (1 - alpha))
    assert measured(each_arrays, both, guessed(wall)).distance[middle] == pytest.approx(exact, rel=0.02)


def test_where_nothing_covers_a_pixel_the_guess_stays(arrays):
    wall = WALLS[0]
    few = opaque(seed_at(wall, np.array([0, 1]), 0.6, 1).gaussians)
    found = measured(arrays, few, guessed(wall, 7.0))
    assert (found.distance[SIZE // 2 :] == 7).all()
    assert found.distance[0, 0] == pytest.approx(wall.distance[0, 0], rel=0.01)


def test_the_sky_stays_where_it_is(arrays):
    wall = replace(guessed(WALLS[0]), sky=100.0)
    wall.distance[:4] = 100
    seeds = opaque(seed_at(WALLS[0], np.arange(SIZE * SIZE), 1.0, 1).gaussians)
    found = measured(arrays, seeds, wall)
    assert (found.distance[:4] == 100).all()
    assert np.allclose(found.distance[6:-2], WALLS[0].distance[6:-2], rtol=0.02)


def test_gaussians_of_the_sky_tell_no_distance(arrays):
    wall = replace(guessed(WALLS[0]), sky=4.0)
    seeds = opaque(seed_at(WALLS[0], np.arange(SIZE * SIZE), 1.0, 1).gaussians)
    assert np.array_equal(measured(arrays, seeds, wall).distance, wall.distance)
