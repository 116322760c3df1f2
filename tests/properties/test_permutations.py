"""The order of Gaussians in memory means nothing, but where depths tie."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import splat
from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from tests.properties.effort import FEW, MANY, tried
from tests.properties.random_scenes import RandomScene, random_scene
from tests.splat.raster import reference
from tests.splat.samples import spheres

SEEDS = st.integers(0, 10_000)
# Depths that agree to one part in 100,000 may count as equal.
TIE = 1e-5


def apart(scene: RandomScene) -> Gaussians:
    """The Gaussians of a scene, without those whose depths tie with that of another one."""
    depth = reference.project(reference.double(scene.gaussians), scene.camera, 0.1)["depth"].numpy()
    order = np.argsort(depth)
    step = np.diff(depth[order]) > 3 * TIE * np.abs(depth[order][1:])
    kept = np.sort(order[np.concatenate([[True], step])])
    return scene.gaussians.select(torch.from_numpy(kept))


def image_and_gradients(g: Gaussians, camera: Camera) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in g.tensors()}
    image = splat.render(Gaussians(**leaves), camera)
    (image * torch.linspace(-1, 1, image.numel()).reshape(image.shape)).sum().backward()
    return image.detach(), {name: leaf.grad for name, leaf in leaves.items()}


def permuted_is_the_same(seed: int) -> None:
    scene = random_scene(seed, most=200)
    g = apart(scene)
    order = torch.from_numpy(np.random.default_rng(seed).permutation(len(g)))
    image, gradients = image_and_gradients(g, scene.camera)
    shuffled, by_shuffled = image_and_gradients(g.select(order), scene.camera)
    # Every pixel adds the same numbers in the same order.
    assert torch.equal(shuffled, image)
    for name, gradient in gradients.items():
        scale = float(gradient.abs().max())
        # Sums over a Gaussian's tiles may be grouped otherwise.
        torch.testing.assert_close(by_shuffled[name], gradient[..., order], rtol=1e-4, atol=1e-5 * scale)


@tried(FEW)
@given(SEEDS)
def test_permuting_gaussians_changes_no_bit_of_the_image(seed):
    permuted_is_the_same(seed)


@pytest.mark.long
@tried(MANY)
@given(SEEDS)
def test_permuting_gaussians_changes_no_bit_of_the_image_long(seed):
    permuted_is_the_same(seed)


def two_at(first: float, second: float) -> Gaussians:
    """Two round Gaussians in one line of sight, a dark one and a bright one, at two depths."""
    pair = spheres([0.0, 0.0], [0.3, 0.3], 0.8)
    pair.means[2] = torch.tensor([first, second])
    return pair


def test_of_equal_depths_the_first_in_memory_is_in_front():
    camera = Camera(np.eye(4), 24, 24, 24.0, 24.0, 12.0, 12.0)
    nearer, farther = 2.0, 2.001
    image = lambda first, second: splat.render(two_at(first, second), camera)  # noqa: E731
    tied, one_first, other_first = image(2.0, 2.0), image(nearer, farther), image(farther, nearer)
    torch.testing.assert_close(tied, one_first, atol=2e-3, rtol=0)
    assert (tied - other_first).abs().max() > 0.1
    # A difference of more than one part in 100,000 is one.
    torch.testing.assert_close(image(2.0 * (1 + 4 * TIE), 2.0), other_first, atol=2e-3, rtol=0)


def test_what_a_tie_may_change_is_bounded():
    """Two splats that swap change a pixel by alpha_1 alpha_2 |c_1 - c_2|, no more."""
    camera = Camera(np.eye(4), 24, 24, 24.0, 24.0, 12.0, 12.0)
    pair = two_at(2.0, 2.0)
    swapped = pair.select(torch.tensor([1, 0]))
    splats = reference.project(reference.double(pair), camera, 0.1)
    alpha = splats["opacity"].max()
    bound = float(alpha**2 * (splats["colour"][:, 0] - splats["colour"][:, 1]).abs().max())
    difference = (splat.render(pair, camera) - splat.render(swapped, camera)).abs().max()
    assert 0.9 * bound < float(difference) < 1.001 * bound


def test_equal_gaussians_may_tie():
    """Copies of one Gaussian have no order that could matter."""
    scene = random_scene(3, most=50)
    one = scene.gaussians.select(torch.zeros(5, dtype=torch.long))
    assert torch.equal(
        splat.render(one, scene.camera), splat.render(one.select(torch.tensor([3, 1, 4, 0, 2])), scene.camera)
    )
