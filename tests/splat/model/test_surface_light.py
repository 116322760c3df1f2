"""Light at points of surfaces, and the nodes that have it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from compose.camera.coordinate_systems import Place
from splat.model.dynamic_light import SurfaceLight
from splat.model.gaussians import Gaussians
from splat.model.trees import Layer, static_layer

TIMES = 5


def floor(instance: int = -1, height: float = 0.0, up: float = 1.0, seed: int = 0) -> SurfaceLight:
    """400 points on a square of side 2, whose light changes where x > 0."""
    rng = np.random.default_rng(seed)
    means = np.vstack([rng.uniform(-1, 1, (2, 400)), np.full(400, height)])
    factors = np.where(means[0] > 0, np.linspace(0.2, 1.8, TIMES)[:, None], 1.0)
    normals = np.tile([[0.0], [0.0], [up]], 400)
    return SurfaceLight(
        torch.from_numpy(means).float(),
        torch.from_numpy(normals).float(),
        torch.full((400,), instance, dtype=torch.int32),
        torch.from_numpy(factors).half()[:, None].repeat(1, 3, 1),
        torch.from_numpy(means[0] > 0),
    )


def joined(*parts: SurfaceLight) -> SurfaceLight:
    return SurfaceLight(
        *(torch.cat([getattr(p, name) for p in parts], dim=-1) for name in SurfaceLight.__dataclass_fields__)
    )


def nodes(means: list[list[float]], instance: int = -1) -> Layer:
    count = len(means)
    gaussians = Gaussians(
        torch.tensor(means).T.contiguous(),
        torch.full((3, count), -3.0),
        torch.tensor([1.0, 0, 0, 0])[:, None].repeat(1, count),
        torch.zeros(count),
        torch.zeros(1, 3, count),
    )
    semantic = torch.full((count,), instance, dtype=torch.int32)
    return replace(static_layer(gaussians), semantic=semantic, dynamic=semantic >= 0)


def test_nodes_have_the_light_of_the_nearest_point():
    light, rng = floor(), np.random.default_rng(1)
    means = rng.uniform(-0.9, 0.9, (3, 50)) * [[1], [1], [0.02]]
    near = light.near(torch.from_numpy(means).float(), torch.full((50,), -1, dtype=torch.int32))
    distance = np.linalg.norm(means[:, :, None] - light.means.double().numpy()[:, None], axis=0)
    expected = np.where(light.changes.numpy()[distance.argmin(axis=1)], distance.argmin(axis=1), -1)
    np.testing.assert_array_equal(near[0], expected)
    np.testing.assert_array_equal(near[1], expected)


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e5])
def test_points_follow_their_place(unit):
    light, place = floor(), Place((3.0, -2.0, 7.0), unit)
    expected = (light.means.double().numpy() - [[3.0], [-2.0], [7.0]]) / unit
    np.testing.assert_allclose(light.placed(place).means, expected, rtol=1e-5, atol=1e-6 / unit)


def test_instances_have_light_of_their_own():
    """Points of the other one are nearer."""
    light = joined(floor(0, 0.3), floor(1, 0.0, seed=2))
    near = light.near(*_at([[0.5, 0.1, 0.02], [0.5, 0.1, 0.02]], [0, 1]))
    assert (near[0] < 400).tolist() == [True, False]
    unknown = light.near(*_at([[0.5, 0.1, 0.02]], [7]))
    assert unknown[0].tolist() == [-1]


def test_what_is_far_from_all_points_has_no_light():
    near = floor().near(*_at([[0.5, 0.0, 0.1], [0.5, 0.0, 3.0], [60.0, 0.0, 0.0]], [-1] * 3))
    assert (near[0] >= 0).tolist() == [True, False, False]


def test_something_thin_has_two_sides():
    """A sheet that was seen from above and below; one seen from above; and two floors far apart."""
    above, below = floor(0, 0.001), floor(0, -0.001, up=-1.0, seed=4)
    both = joined(above, below)
    near = both.near(*_at([[0.5, 0.2, 0.0005]], [0]))
    for index in near:
        assert float((both.means[:2, index[0]] - torch.tensor([0.5, 0.2])).norm()) < 0.3
    assert float(both.normals[2, near[0][0]]) == -float(both.normals[2, near[1][0]])
    for one in (above, joined(above, floor(0, -1.5, up=-1.0))):
        alone = one.near(*_at([[0.5, 0.2, 0.0]], [0]))
        assert alone[0].tolist() == alone[1].tolist() != [-1]


def test_the_course_of_nodes():
    above, below = floor(0, 0.001), floor(0, -0.001, up=-1.0, seed=4)
    both = joined(above, replace(below, factors=below.factors.flip(0)))
    course = both.course(nodes([[-0.5, 0.0, 0.0], [0.5, 0.0, 0.001], [0.6, 0.1, 0.0]], 0))
    assert course is not None
    assert course.nodes.tolist() == [1, 2]
    assert course.sided.tolist() == [0, 1]
    rising = torch.linspace(0.2, 1.8, TIMES).half()[:, None].repeat(1, 3)
    for node in range(2):
        up = float(course.normals[2, node]) > 0
        torch.testing.assert_close(course.factors[..., node], rising if up else rising.flip(0))
        torch.testing.assert_close(course.behind[..., node], rising.flip(0) if up else rising)


def test_nodes_in_light_that_stays_have_no_course():
    assert floor().course(nodes([[-0.5, 0.0, 0.0], [-0.2, 0.4, 0.0]])) is None


def test_a_single_point_is_enough():
    light = floor()
    chosen = torch.nonzero(light.changes)[:1, 0]
    one = SurfaceLight(*(getattr(light, name)[..., chosen] for name in SurfaceLight.__dataclass_fields__))
    near = one.near(one.means, one.instance)
    assert near[0].tolist() == near[1].tolist() == [0]


def _at(means: list[list[float]], instance: list[int]) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.tensor(means).T.contiguous(), torch.tensor(instance, dtype=torch.int32)
