"""The sky is drawn where rays see light and hit nothing: far behind all else, in every direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.coordinate_systems import Place
from splat.model.gaussians import SH_DC, perceptual_from_radiance
from splat.model.trees import check_forest
from splat.raster.differentiable import render_differentiable
from splat.training.initialization import seed_from_views, whole_sky
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import (
    SKY_DISTANCE,
    TrainingView,
    pixel_footprint,
    place_of,
    placed,
    reduced,
    shows_sky,
)
from tests.extremes import extreme
from tests.splat.training.frames import SIZE, WALLS, in_the_open

PLACE = Place((0.1, 0.2, 0.3), 0.5)
HITS_NOTHING = np.isinf(in_the_open(0.0, ground=True).distance)


def test_what_sees_light_and_hits_nothing_is_the_sky():
    view = in_the_open(0.0, ground=True)
    np.testing.assert_array_equal(shows_sky(view.radiance, view.distance), HITS_NOTHING)
    assert 0.3 < HITS_NOTHING.mean() < 0.7
    assert not shows_sky(WALLS[0].radiance, WALLS[0].distance).any()


def test_the_void_is_none_nor_are_edges_before_it():
    view = in_the_open(0.0, ground=True)
    radiance = np.where(HITS_NOTHING[..., None], 0, view.radiance).astype(np.float32)
    assert not shows_sky(radiance, view.distance).any()
    # Not even one that is all edges: most of what hits nothing is dark.
    dotted = radiance.copy()
    dotted[::16, ::16] = 0.2
    assert not shows_sky(dotted, view.distance).any()
    # A pixel at the edge of the ground, of which some samples see the ground.
    last = int(np.flatnonzero(HITS_NOTHING.all(axis=1))[-1])
    radiance[last] = 0.2
    assert not shows_sky(radiance, view.distance).any()
    assert not shows_sky(np.zeros_like(radiance), np.full_like(view.distance, np.inf)).any()


def test_the_sky_has_a_place_far_away_and_faces_the_viewer():
    view = in_the_open(0.0, ground=True)
    far = HITS_NOTHING.copy()
    view.distance[-1, 0] = 0.5 * SKY_DISTANCE * 1.001
    far[-1, 0] = True
    own = placed(view, PLACE)
    assert (own.distance[far] == SKY_DISTANCE).all()
    np.testing.assert_allclose(own.distance[~far], view.distance[~far] * 2, rtol=1e-6)
    rays = view.camera.rays(view.camera.pixel_centres()).reshape(SIZE, SIZE, 3)
    np.testing.assert_allclose(own.normal[far], -rays[far], atol=1e-6)
    np.testing.assert_array_equal(own.normal[~far], view.normal[~far])
    # It can be drawn, and yet is no surface whose distance counts.
    assert len(own.surface_pixels) == SIZE * SIZE
    assert len(own.some_surface_pixels) == np.count_nonzero(~far)
    assert reduced(own, 2).sky == own.sky == SKY_DISTANCE


def test_scales_are_those_of_surfaces():
    views = [in_the_open(x, ground=True) for x in (-0.3, 0.3)]
    place = place_of(views)
    before = pixel_footprint([replace(v, distance=(v.distance / place.unit)) for v in views])
    assert pixel_footprint([placed(view, place) for view in views]) == pytest.approx(before, rel=1e-6)


def test_closed_scenes_are_as_before():
    own = placed(WALLS[0], PLACE)
    assert own.normal is WALLS[0].normal
    np.testing.assert_array_equal(
        own.distance, (WALLS[0].distance.astype(np.float64) / 0.5).astype(np.float32)
    )
    seeds = seed_from_views([placed(view, PLACE) for view in WALLS], 200, 0, np.random.default_rng(0))
    assert 180 <= len(seeds) <= 200
    assert float(seeds.gaussians.means.norm(dim=0).max()) < SKY_DISTANCE


def test_a_few_bright_pixels_are_no_sky():
    """One pixel of a thousand: seeds of all directions come with a sky only."""
    views = [placed(view, PLACE) for view in WALLS]
    for count, there in ((1, False), (9, True)):
        for view in views:
            view.distance.ravel()[:count] = SKY_DISTANCE
        seeds = seed_from_views(views, 200, 0, np.random.default_rng(0)).gaussians
        assert (float(seeds.means.norm(dim=0).max()) > SKY_DISTANCE * 1.1) == there


def test_the_whole_sky_is_what_is_not_ground():
    """Seen: a cone of sky above the horizon ahead, and of ground below it. Unseen: all else."""
    azimuth, height = (a.ravel() for a in np.meshgrid(np.linspace(-0.6, 0.6, 40), np.linspace(-0.5, 0.5, 40)))
    seen = np.stack(
        [np.cos(height) * np.sin(azimuth), np.cos(height) * np.cos(azimuth), np.sin(height)], axis=1
    )
    above = height > 0
    colour = np.where(azimuth[above, None] < 0, [0.1, 0.2, 0.6], [0.6, 0.5, 0.3]).astype(np.float32)
    # The sun is no colour of its surroundings.
    colour[7] = 1e5
    found = whole_sky(seen[above], colour, seen[~above], degree=1)
    distance = found.means.norm(dim=0)
    assert (distance > SKY_DISTANCE).all()
    way = (found.means / distance).T.double().numpy()
    for direction, is_there in (([0, 0, 1], True), ([0, -1, 0.4], True), ([0, 0, -1], False)):
        nearest = np.arccos(min(1, (way @ direction).max() / np.linalg.norm(direction)))
        assert (nearest < 0.1) == is_there, direction
    shown = (found.sh[0] * SH_DC + 0.5).T.numpy()
    left, right = (
        perceptual_from_radiance(torch.tensor(c)).numpy() for c in ([0.1, 0.2, 0.6], [0.6, 0.5, 0.3])
    )
    np.testing.assert_allclose(shown[way[:, 0] < -0.3], np.tile(left, (sum(way[:, 0] < -0.3), 1)), atol=0.02)
    np.testing.assert_allclose(shown[way[:, 0] > 0.3], np.tile(right, (sum(way[:, 0] > 0.3), 1)), atol=0.02)
    assert len(whole_sky(seen[above], colour, np.zeros((0, 3)), degree=0)) == 2000


def psnr(arrays, trainer: Trainer, view: TrainingView) -> float:
    """Of a view on the perceptual scale, in dB."""
    image = render_differentiable(
        arrays, trainer.forest()[-1].gaussians, trainer.place.camera(view.camera)
    ).detach()
    shown, target = (
        perceptual_from_radiance(i).clamp(0, 1) for i in (image, torch.from_numpy(view.radiance))
    )
    return float(-10 * torch.log10(((shown - target) ** 2).mean()))


@pytest.mark.parametrize(
    "shown",
    [
        pytest.param(
            shown,
            marks=extreme(
                name,
                given=f"{given}; 3 views, 60 steps",
                expected="held-out at least 24 dB; 60 degrees up, where no view looks, 18 dB",
            ),
        )
        for shown, name, given in [
            ({"ball": True}, "one small object before the sky", "a ball of 2 % of the frame, all else sky"),
            ({"ground": True}, "ground plane only", "a plane that reaches to the horizon, and the sky"),
            ({"ground": True, "sun": True}, "sun in view", "radiance 1e4 on 4 degrees of the sky"),
        ]
    ],
)
def test_open_scenes_are_learnt(arrays, shown, got):
    views = [in_the_open(x, **shown) for x in (-0.4, 0.0, 0.4)]
    trainer = Trainer(arrays, views, TrainingSettings(iterations=60, gaussians=600, layers=2, degree=1))
    trainer.run()
    layers = trainer.forest()
    check_forest(layers)
    assert all(layer.gaussians.is_finite() for layer in layers)
    assert got(psnr(arrays, trainer, in_the_open(0.2, **shown)), ".1f") > 24
    assert got(psnr(arrays, trainer, in_the_open(0.2, pitch=60.0)), ".1f") > 18
