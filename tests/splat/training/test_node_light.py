"""Training in light that changes and is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from splat.model.dynamic_light import NodeLight, SurfaceLight, factors_at, in_light, seen_from_behind
from splat.raster.differentiable import render_differentiable
from splat.training import layer_training
from splat.training.initialization import seed_at
from splat.training.trainer import Trainer, TrainingSettings
from splat.training.training_view import TrainingView
from tests.splat.model.test_surface_light import floor, joined, nodes
from tests.splat.training.frames import SIZE, wall

# The light on the right half of the wall falls to this share.
LEAST = 0.15
TIMES = np.linspace(0, 1, 9)
SETTINGS = TrainingSettings(iterations=160, gaussians=900, layers=2, degree=0, seed=3)


def factor(x: np.ndarray, time: float) -> np.ndarray:
    return np.where(x > 0, 1 - (1 - LEAST) * time, 1.0)


def shaded(x: float, time: float) -> TrainingView:
    """The wall, whose right half gets darker; and no lamp."""
    view = wall(x)
    points = view.points(np.arange(SIZE**2))
    radiance = np.minimum(view.radiance.reshape(-1, 3), 0.6) * factor(points[:, 0], time)[:, None]
    return replace(view, radiance=radiance.reshape(SIZE, SIZE, 3).astype(np.float32), time=time)


VIEWS = [shaded(x, time) for time, x in zip(TIMES, np.tile([-0.4, 0.0, 0.4], 3), strict=True)]


def light() -> SurfaceLight:
    """At pixels of one view."""
    view = wall(0.0)
    points = view.points(np.arange(0, SIZE**2))
    factors = np.stack([factor(points[:, 0], time) for time in TIMES])
    return SurfaceLight(
        torch.from_numpy(points.T.copy()).float(),
        torch.tensor([[0.0], [0.0], [-1.0]]).repeat(1, len(points)),
        torch.full((len(points),), -1, dtype=torch.int32),
        torch.from_numpy(factors).half()[:, None].repeat(1, 3, 1),
        torch.from_numpy(points[:, 0] > 0),
    )


def trained(arrays, known: bool, settings: TrainingSettings = SETTINGS) -> Trainer:
    trainer = Trainer(arrays, VIEWS, settings, light=light() if known else None)
    trainer.run()
    return trainer


@pytest.fixture(scope="module")
def whole(arrays) -> Trainer:
    return trained(arrays, True)


def test_known_light_is_learnt_out_of_the_frames(arrays, whole):
    """The darkest time, of the half that gets dark, is farthest from what training has seen most."""
    found = []
    for known in (False, True):
        trainer = whole if known else trained(arrays, False)
        layer = trainer.forest()[-1]
        gaussians = layer.gaussians
        if known:
            course = trainer.light.course(layer)
            gaussians = in_light(gaussians, course.nodes, factors_at(course.factors, 1.0))
        view = shaded(0.1, 1.0)
        image = render_differentiable(arrays, gaussians, trainer.place.camera(view.camera)).numpy()
        dark = view.points(np.arange(SIZE**2))[:, 0].reshape(SIZE, SIZE) > 0.1
        found.append(abs(float(image[dark].mean() / view.radiance[dark].mean()) - 1))
    assert found[0] > 1
    assert found[1] < 0.1


SHORT = replace(SETTINGS, iterations=40)


@pytest.fixture(scope="module")
def often() -> Iterator[None]:
    """Nodes look for their light every 10 steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layer_training, "_LIT_EVERY", 10)
        yield


@pytest.fixture(scope="module")
def short(arrays, often) -> Trainer:
    return trained(arrays, True, SHORT)


@pytest.mark.parametrize("stop", [8, 28])
def test_an_interrupted_training_ends_with_the_same_bits(arrays, short, stop):
    first, second = (Trainer(arrays, VIEWS, SHORT, light=light()) for _ in range(2))
    first.run(until=stop)
    second.restore(*first.state())
    second.run()
    for name, tensor in short.state()[0].items():
        torch.testing.assert_close(second.state()[0][name], tensor, rtol=0, atol=0)


def test_seeds_have_the_radiance_of_usual_light(arrays):
    """Seen in the dark and in light, the same surface has the same seeds."""
    lit = NodeLight(light())
    found = [seed_at(shaded(0.0, time), np.arange(SIZE**2), 0.6, 0, None, lit) for time in (0.0, 0.75)]
    torch.testing.assert_close(found[0].gaussians.sh, found[1].gaussians.sh, rtol=1e-3, atol=1e-3)
    plain = seed_at(shaded(0.0, 0.75), np.arange(SIZE**2), 0.6, 0)
    assert float((plain.gaussians.sh - found[1].gaussians.sh).abs().max()) > 0.3


def test_gradients_are_those_of_finite_differences():
    both = joined(floor(0, 0.001), floor(0, -0.001, up=-1.0, seed=4))
    layer = nodes([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.001], [0.6, 0.1, -0.001]], 0)
    lit = NodeLight(both)
    lit.follow(layer)
    camera, index = VIEWS[0].camera, torch.arange(3)
    sh = torch.from_numpy(np.random.default_rng(2).normal(0.2, 0.3, (4, 3, 3))).requires_grad_()

    def of(sh: torch.Tensor) -> torch.Tensor:
        own = replace(layer.gaussians, sh=sh)
        return lit.lit(own, own, index, camera, 0.8).sh

    assert torch.autograd.gradcheck(of, (sh,))


def test_which_side_is_seen_follows_the_turn():
    """Against rotation matrices in float64."""
    rng = np.random.default_rng(5)
    count = 200
    normals = rng.normal(size=(3, count))
    normals /= np.linalg.norm(normals, axis=0)
    rest, now = rng.normal(size=(2, 4, count))
    means, eye = rng.normal(size=(3, count)), rng.normal(size=3)
    found = seen_from_behind(*(torch.from_numpy(part) for part in (normals, rest, now, means, eye)))

    def matrix(quaternion: np.ndarray) -> np.ndarray:
        w, x, y, z = quaternion / np.linalg.norm(quaternion)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    for n in range(count):
        turned = matrix(now[:, n]) @ matrix(rest[:, n]).T @ normals[:, n]
        assert bool(found[n]) == bool(turned @ (eye - means[:, n]) < 0)
