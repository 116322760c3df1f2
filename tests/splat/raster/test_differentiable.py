"""The rasterizer against its plain float64 twin: image and every gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from compose.camera.camera import Camera, camera_from_pose
from splat.model.gaussians import Gaussians
from splat.raster.differentiable import render_differentiable
from tests.splat.raster import reference


def camera(width: int = 40, height: int = 36) -> Camera:
    """Looks along +z from z = -4, tilted so that no axis is special."""
    angle = 0.2
    pose = np.eye(4)
    pose[:3, :3] = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    pose[:3, 3] = [-0.8, 0.1, -4]
    return camera_from_pose(pose, width, height, 45.0, 48.0, width / 2 + 1.5, height / 2 - 0.5)


def gaussians(kind: str, n: int = 60, degree: int = 3) -> Gaussians:
    """Random Gaussians; `kind` says what is extreme about them."""
    g = torch.Generator().manual_seed(7)
    normal = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    means, log_scales, logits = normal(3, n), normal(3, n) * 0.4 - 1.6, normal(n)
    if kind == "off-screen":
        means *= torch.tensor([6.0, 6.0, 1.0])[:, None]
    if kind == "behind the camera":
        means[2] = means[2] * 5 - 4
    if kind == "nearly opaque":
        logits += 7
    if kind == "nearly flat":
        log_scales[2] = -9.0
    sh = normal((degree + 1) ** 2, 3, n) * 0.2
    sh[0] += 0.8
    return Gaussians(means, log_scales, normal(4, n), logits, sh)


KINDS = ["overlap", "off-screen", "behind the camera", "nearly opaque", "nearly flat"]


def both(arrays, g: Gaussians, cam: Camera, low_pass: float, weight: torch.Tensor):
    """Images and gradients by every parameter of sum(weight * image), of kernel and twin."""
    results = []
    for dtype, render in (
        (torch.float32, lambda p: render_differentiable(arrays, p, cam, low_pass)),
        (torch.float64, lambda p: reference.render(p, cam, low_pass)),
    ):
        leaves = {name: t.to(dtype).clone().requires_grad_() for name, t in g.tensors()}
        image = render(Gaussians(**leaves))
        (image * weight.to(dtype)).sum().backward()
        results.append((image.detach().double(), {k: v.grad.double() for k, v in leaves.items()}))
    return results


@pytest.mark.parametrize("kind", KINDS)
def test_image_and_gradients_equal_the_twins(arrays, kind):
    g, cam = gaussians(kind), camera()
    weight = torch.randn(cam.height, cam.width, 3, generator=torch.Generator().manual_seed(1))
    (image, gradients), (expected, expected_gradients) = both(arrays, g, cam, 0.1, weight)
    # Worst seen: 1.1e-4 where a block stopped at a transmittance of 1e-4, else 4e-6.
    torch.testing.assert_close(image, expected, atol=2e-4, rtol=1e-4)
    for name, value in expected_gradients.items():
        scale = value.abs().max()
        assert scale > 0
        # Relative to the largest gradient of its kind; worst seen 6e-4, at the steps of 1/255.
        error = (gradients[name] - value).abs().max() / scale
        assert error < 2e-3, f"{name}: {error}"


def test_gradients_equal_finite_differences(arrays):
    """Along each parameter's own gradient, under a smooth weight.

    The cut at 1/255 moves with a Gaussian's edge, which no gradient knows of; under a weight that varies
    slowly, what it adds on one side it takes on the other.
    """
    g, cam = gaussians("overlap", n=25, degree=1), camera()
    x, y = torch.meshgrid(torch.arange(cam.width), torch.arange(cam.height), indexing="xy")
    weight = torch.stack([torch.sin(x / 9.0), torch.cos(y / 7.0), torch.sin((x + y) / 11.0)], dim=-1)
    leaves = {k: t.clone().requires_grad_() for k, t in g.tensors()}
    (render_differentiable(arrays, Gaussians(**leaves), cam) * weight).sum().backward()
    for name, leaf in leaves.items():
        # Uphill, the derivative is as large as it gets and rounding as small.
        direction = leaf.grad / leaf.grad.norm()
        values = []
        for step in (-2e-3, 2e-3):
            moved = {k: v.detach() + (step * direction if k == name else 0) for k, v in leaves.items()}
            values.append((render_differentiable(arrays, Gaussians(**moved), cam) * weight).sum().item())
        slope = (values[1] - values[0]) / 4e-3
        assert slope == pytest.approx(leaf.grad.norm().item(), rel=0.03), name


def test_one_gaussian_has_the_closed_form(arrays):
    """Isotropic, sd 0.5 at depth 4 with f 40: sd 5 px; at its centre alpha is the compensated opacity."""
    cam = Camera(np.eye(4), 33, 33, 40.0, 40.0, 16.5, 16.5)
    sh = torch.full((1, 3, 1), 0.5 / 0.28209479177387814)
    one = Gaussians(
        torch.tensor([[0.0], [0.0], [4.0]]),
        torch.full((3, 1), float(np.log(0.5))),
        torch.tensor([[1.0], [0], [0], [0]]),
        torch.zeros(1),
        sh,
    )
    image = render_differentiable(arrays, one, cam, 0.3)
    compensation = 25 / 25.3
    assert image[16, 16, 0].item() == pytest.approx(0.5 * compensation, rel=1e-5)
    expected = 0.5 * compensation * np.exp(-(5**2) / (2 * 25.3))
    assert image[16, 21, 1].item() == pytest.approx(expected, rel=1e-4)


def test_the_same_input_gives_the_same_bits(arrays):
    g, cam = gaussians("overlap", n=300), camera(70, 50)
    weight = torch.randn(cam.height, cam.width, 3, generator=torch.Generator().manual_seed(1))
    runs = []
    for _ in range(2):
        leaves = {k: t.clone().requires_grad_() for k, t in g.tensors()}
        (render_differentiable(arrays, Gaussians(**leaves), cam) * weight).sum().backward()
        runs.append([leaf.grad for leaf in leaves.values()])
    for first, second in zip(*runs, strict=True):
        assert torch.equal(first, second)


@pytest.mark.parametrize("extreme", ["huge", "tiny", "at the eye", "zero quaternion", "not a number"])
def test_extremes_give_finite_pictures_and_gradients(arrays, extreme):
    g, cam = gaussians("overlap", n=20), camera()
    if extreme == "huge":
        g.log_scales[:, 0] = 12
    if extreme == "tiny":
        g.log_scales[:, 0] = -30
    if extreme == "at the eye":
        g.means[:, 0] = torch.tensor(cam.position, dtype=torch.float32)
    if extreme == "zero quaternion":
        g.rotations[:, 0] = 0
    if extreme == "not a number":
        g.means[:, 0] = float("nan")
    leaves = {k: t.clone().requires_grad_() for k, t in g.tensors()}
    image = render_differentiable(arrays, Gaussians(**leaves), cam)
    image.sum().backward()
    assert torch.isfinite(image).all()
    for name, leaf in leaves.items():
        finite = leaf.grad[..., 1:] if extreme == "not a number" else leaf.grad
        assert torch.isfinite(finite).all(), name


def test_nothing_to_draw_is_black(arrays):
    g = gaussians("overlap", n=5)
    g.means[2] = -50
    assert render_differentiable(arrays, g, camera()).abs().max() == 0
