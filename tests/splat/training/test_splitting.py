"""Nodes that are too large for the edges of shadows, and their halves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.dynamic_light import SurfaceLight
from splat.model.motion import turned
from splat.raster.differentiable import render_differentiable
from splat.training import layer_training
from splat.training.density import halves, too_large
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests.splat.model.test_surface_light import floor, nodes
from tests.splat.training.frames import SIZE, WALLS, wall

TIMES = np.linspace(0, 1, 21)
STEPS = 120
SETTINGS = TrainingSettings(iterations=STEPS, gaussians=400, layers=1, degree=0, seed=3)


@pytest.fixture
def enough(monkeypatch) -> None:
    """Trainings of STEPS steps are long enough to split nodes."""
    monkeypatch.setattr(layer_training, "LEAST_STEPS", STEPS)


def sweeping(changes: bool = True) -> SurfaceLight:
    """On the wall, an edge of a shadow that passes over the half with x > 0."""
    points = wall(0.0).points(np.arange(SIZE**2))
    edge = points[:, 0].max() * TIMES[:, None]
    factors = np.where((points[:, 0] > 0) & (points[:, 0] < edge), 0.2, 1.0)
    factors = factors if changes else np.ones_like(factors)
    return SurfaceLight(
        torch.from_numpy(points.T.copy()).float(),
        torch.tensor([[0.0], [0.0], [-1.0]]).repeat(1, len(points)),
        torch.full((len(points),), -1, dtype=torch.int32),
        torch.from_numpy(factors).half()[:, None].repeat(1, 3, 1),
        torch.from_numpy(np.ptp(factors, axis=0) > 0),
    )


def under(light: SurfaceLight, scale: float, brightness: float = 0.5):
    """Nodes at every 40th point, of one size and colour."""
    layer = nodes(light.means[:, ::40].T.tolist())
    sh = torch.full_like(layer.gaussians.sh, (brightness - 0.5) / 0.28209479177387814)
    log_scales = torch.full_like(layer.gaussians.log_scales, float(np.log(scale)))
    return replace(layer, gaussians=replace(layer.gaussians, sh=sh, log_scales=log_scales))


def test_light_is_uneven_where_it_differs_between_neighbours():
    """Against all pairs of the nearest six, in float64."""
    light = floor()
    found = light.unevenness(light.means, light.instance).double().numpy()
    means, factors = light.means.double().numpy(), light.factors.double().numpy() ** (1 / 2.2)
    for index in range(0, 400, 7):
        away = np.linalg.norm(means - means[:, index, None], axis=0)
        near = np.argsort(away)[1:7]
        change = ((factors[..., near] - factors[..., index, None]) ** 2).mean(axis=(0, 1))
        expected = (change / away[near]).mean()
        assert found[index] == pytest.approx(expected, rel=1e-4, abs=1e-7)
    assert found.max() > 0
    assert (found[np.abs(means[0]) > 0.5] == 0).all()


def test_light_around_a_corner_and_out_of_reach_counts_as_even():
    light = floor()
    corner = replace(light, normals=light.normals.where(light.means[0] > 0, torch.tensor([[1.0], [0], [0]])))
    assert float(corner.unevenness(light.means, light.instance).max()) == 0
    assert float(light.unevenness(light.means + 10, light.instance).max()) == 0
    assert float(light.unevenness(light.means, light.instance + 1).max()) == 0


def test_a_single_point_is_even():
    one = floor()
    index = torch.tensor([0])
    one = SurfaceLight(*(getattr(one, name)[..., index] for name in SurfaceLight.__dataclass_fields__))
    assert one.unevenness(one.means, one.instance).tolist() == [0.0]


def test_large_nodes_under_passing_edges_are_too_large():
    light = sweeping()
    layer = under(light, 0.3)
    found = too_large(layer, light, WALLS)
    assert bool(found.any())
    x = layer.gaussians.means[0]
    assert not bool(found[x < -0.1].any())
    assert int(found.sum()) == int(0.1 * len(layer))


def test_nodes_of_what_moves_are_not_too_large():
    light = replace(sweeping(), instance=torch.zeros(SIZE**2, dtype=torch.int32))
    layer = under(light, 0.3)
    semantic = torch.zeros(len(layer), dtype=torch.int32)
    assert not bool(too_large(replace(layer, semantic=semantic), light, WALLS).any())


@pytest.mark.parametrize(
    ("scale", "brightness", "changes"),
    [(1e-4, 0.5, True), (0.3, 0.0, True), (0.3, 0.5, False)],
    ids=["small", "black", "even light"],
)
def test_other_nodes_are_not(scale: float, brightness: float, changes: bool):
    light = sweeping(changes)
    assert not bool(too_large(under(light, scale, brightness), light, WALLS).any())


def test_halves_have_the_moments_of_the_whole():
    rng = np.random.default_rng(0)
    layer = nodes(rng.normal(size=(30, 3)).tolist())
    rotations, log_scales = (torch.from_numpy(rng.normal(size=(n, 30))).float() for n in (4, 3))
    whole = replace(layer.gaussians, rotations=rotations, log_scales=log_scales)
    halved = halves(replace(layer, gaussians=whole))
    a, b = (halved.select(torch.arange(30) + first).gaussians for first in (0, 30))
    torch.testing.assert_close((a.means + b.means) / 2, whole.means)
    longest = log_scales.max(dim=0).values.exp()
    apart = torch.zeros_like(log_scales)
    apart[log_scales.argmax(dim=0), torch.arange(30)] = longest
    axis = turned(rotations / rotations.norm(dim=0), apart) / longest
    spread = ((a.means - whole.means) * axis).sum(dim=0)
    along = a.log_scales.gather(0, log_scales.argmax(dim=0)[None])[0].exp()
    torch.testing.assert_close((spread**2 + along**2).sqrt(), longest, rtol=0.05, atol=0)


@pytest.mark.parametrize(("logit", "tolerance"), [(-2.0, 0.15), (0.0, 0.15), (3.0, 0.4)])
def test_halves_look_like_the_whole(arrays, logit: float, tolerance: float):
    """Opaque ones reach a little farther: two of them hide more where both are faint."""
    camera = WALLS[0].camera
    ahead = torch.from_numpy(camera.position + 2 * camera.world_to_camera[2, :3]).float()
    layer = nodes([ahead.tolist()])
    log_scales = torch.tensor([[0.4], [0.1], [0.02]]).log()
    gaussians = replace(layer.gaussians, log_scales=log_scales, opacity_logits=torch.full((1,), logit))
    images = [
        render_differentiable(arrays, shown, camera).numpy()
        for shown in (gaussians, halves(replace(layer, gaussians=gaussians)).gaussians)
    ]
    assert images[0].max() > 0.01
    assert np.abs(images[1] - images[0]).max() < tolerance * images[0].max()


def test_training_has_more_and_smaller_nodes_under_shadows(arrays, enough):
    """None are split where the same light does not change."""
    counts, sizes = [], []
    for changes in (False, True):
        trainer = Trainer(arrays, [_at(0.0), _at(0.9)], SETTINGS, light=sweeping(changes))
        trainer.run()
        finest = trainer.forest()[-1].gaussians
        counts.append(len(finest))
        crossed = finest.means[0] * trainer.place.unit + trainer.place.origin[0] > 0.1
        sizes.append(float(finest.log_scales.max(dim=0).values[crossed].mean()))
    assert counts[0] == SETTINGS.gaussians
    assert counts[1] > counts[0]
    assert sizes[1] < sizes[0]


def test_short_trainings_split_nothing(arrays, enough):
    settings = replace(SETTINGS, iterations=STEPS - 1)
    trainer = Trainer(arrays, [_at(0.0), _at(0.9)], settings, light=sweeping())
    trainer.run()
    assert len(trainer.forest()[-1]) == SETTINGS.gaussians


def _at(time: float) -> TrainingView:
    return replace(wall(0.1 * time), time=time)
