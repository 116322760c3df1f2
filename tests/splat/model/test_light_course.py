"""Factors on the radiance of nodes over time."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splat.model.dynamic_light import LightCourse, factors_at, in_light
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance, radiance_from_perceptual
from tests.splat.samples import gaussians


def white(factors: list[list[float]]) -> torch.Tensor:
    """Factors (T, M), the same for all channels."""
    return torch.tensor(factors, dtype=torch.float16)[:, None].repeat(1, 3, 1)


def ones(times: int, nodes: int) -> torch.Tensor:
    return white([[1.0] * nodes] * times)


def lit(sh: torch.Tensor, factor: torch.Tensor) -> torch.Tensor:
    """Spherical harmonics (K, 3, M) of Gaussians in a light."""
    n = sh.shape[2]
    zero = torch.zeros(3, n)
    return in_light(Gaussians(zero, zero, torch.zeros(4, n), zero[0], sh), torch.arange(n), factor).sh


def course() -> LightCourse:
    return LightCourse(torch.tensor([2, 5]), white([[1.0, 0.5], [0.0, 0.5], [2.0, 1.5]]))


def test_factors_are_linear_between_their_times():
    for time, expected in (
        (0.0, [1, 0.5]),
        (0.25, [0.5, 0.5]),
        (0.5, [0, 0.5]),
        (0.9, [1.6, 1.3]),
        (1.0, [2, 1.5]),
    ):
        found = factors_at(course().factors, time)
        torch.testing.assert_close(found, torch.tensor(expected).float().repeat(3, 1), rtol=1e-3, atol=0)


def test_the_perceptual_scale_is_inverted():
    radiance = torch.logspace(-6, 4, 60)
    torch.testing.assert_close(
        radiance_from_perceptual(perceptual_from_radiance(radiance)), radiance, rtol=1e-4, atol=0
    )


def test_the_mean_radiance_has_the_factor():
    """Against the curve in NumPy, below and above its bend and above 1."""
    radiance = np.array([[0.001, 0.2, 7.0], [0.05, 0.5, 1.0], [0.004, 3.0, 30.0]])
    factor = np.array([[0.3, 1.0, 2.5], [0.6, 1.1, 0.1], [1.7, 0.0, 1.0]])

    def curve(value: np.ndarray) -> np.ndarray:
        return np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)

    sh = torch.from_numpy(np.random.default_rng(0).normal(0, 0.1, (4, 3, 3)))
    sh[0] = torch.from_numpy((curve(radiance) - 0.5) / SH_DC)
    found = lit(sh, torch.from_numpy(factor))
    np.testing.assert_allclose(0.5 + SH_DC * found[0], curve(radiance * factor), rtol=1e-6)
    ratio = curve(radiance * factor) / curve(radiance)
    np.testing.assert_allclose(found[1:], sh[1:] * torch.from_numpy(ratio), rtol=1e-6)


def test_without_light_there_is_nothing_to_change():
    sh = torch.full((1, 3, 2), -0.5 / SH_DC)
    for factor in (0.0, 1.0, 8.0):
        torch.testing.assert_close(lit(sh, torch.full((3, 2), factor)), sh)
    grey = torch.zeros(4, 3, 2)
    torch.testing.assert_close(lit(grey, torch.ones(3, 2)), grey, atol=1e-6, rtol=0)
    assert bool(torch.isfinite(lit(grey, torch.zeros(3, 2))).all())


def test_harmonics_that_only_some_have_are_scaled_as_much():
    g = gaussians(n=9, degree=2)
    nodes, factor = torch.tensor([7, 1, 4]), torch.rand(3, 3, generator=torch.Generator().manual_seed(3)) * 2
    kept = torch.tensor([True, False, False] * 3)
    some = in_light(g.turning(kept), nodes, factor).all_turning()
    whole = in_light(g, nodes, factor)
    torch.testing.assert_close(some.sh[0], whole.sh[0])
    torch.testing.assert_close(some.sh[1:], torch.where(kept, whole.sh[1:], 0))


@pytest.mark.parametrize(
    ("nodes", "factors", "said"),
    [
        (torch.tensor([1, 2]), ones(3, 1), "nodes and factors of"),
        (torch.tensor([1, 2]).int(), ones(3, 2), "nodes and factors of"),
        (torch.tensor([1, 2]), ones(3, 2).float(), "nodes and factors of"),
        (torch.tensor([1, 2]), ones(3, 2)[:, 0], "nodes and factors of"),
        (torch.tensor([1, 2]), ones(1, 2), "factors at 1 times; must be two or more"),
    ],
)
def test_shapes_are_checked(nodes, factors, said):
    with pytest.raises(ValueError, match=said):
        LightCourse(nodes, factors)


@pytest.mark.parametrize(
    ("sided", "behind", "normals", "said"),
    [
        (torch.tensor([0]), ones(2, 1), torch.ones(3, 1), "factors at 3 and 2 times"),
        (torch.tensor([2]), ones(3, 1), torch.ones(3, 1), "sides of more than 2 nodes"),
        (torch.tensor([-1]), ones(3, 1), torch.ones(3, 1), "sides of more than 2 nodes"),
        (torch.tensor([0]), ones(3, 1), torch.ones(3, 2), "normals of"),
        (torch.tensor([0]), ones(3, 2), torch.ones(3, 1), "sided and behind of"),
    ],
)
def test_sides_are_checked(sided, behind, normals, said):
    with pytest.raises(ValueError, match=said):
        LightCourse(torch.tensor([2, 5]), ones(3, 2), sided, behind, normals)


def test_both_sides_have_factors_of_their_own():
    behind = white([[2.0], [4.0], [0.0]])
    both = LightCourse(torch.tensor([2, 5]), course().factors, torch.tensor([1]), behind, torch.ones(3, 1))
    torch.testing.assert_close(factors_at(both.factors, 0.25), factors_at(course().factors, 0.25))
    torch.testing.assert_close(factors_at(both.behind, 0.25), torch.full((3, 1), 3.0))


def test_a_part_of_the_nodes_keeps_its_factors():
    nodes = torch.tensor([1, 3, 4, 8])
    behind, normals = white([[5.0, 6.0], [7.0, 8.0]]), torch.eye(3)[:, :2]
    whole = LightCourse(nodes, white([[1, 2, 3, 4], [5, 6, 7, 8]]), torch.tensor([1, 3]), behind, normals)
    part = whole.among(2, 8)
    assert part.nodes.tolist() == [3, 4]
    torch.testing.assert_close(part.factors, whole.factors[..., 1:3])
    assert part.sided.tolist() == [0]
    torch.testing.assert_close(part.behind, behind[..., :1])
    torch.testing.assert_close(part.normals, normals[:, :1])
    assert len(whole.among(5, 8).nodes) == 0
