"""Cameras and Gaussians for tests."""

from __future__ import annotations

import numpy as np
import torch

from compose.camera.camera import Camera, camera_from_pose
from splat.model.gaussians import SH_DC, Gaussians

# What is extreme about `gaussians`.
KINDS = ["overlap", "off-screen", "behind the camera", "nearly opaque", "nearly flat"]


def camera(width: int = 40, height: int = 36) -> Camera:
    """Looks along +z from z = -4, turned and off-centre so that no axis is special."""
    angle = 0.2
    pose = np.eye(4)
    pose[:3, :3] = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    pose[:3, 3] = [-0.8, 0.1, -4]
    return camera_from_pose(pose, width, height, 45.0, 48.0, width / 2 + 1.5, height / 2 - 0.5)


def gaussians(kind: str = "overlap", n: int = 60, degree: int = 3) -> Gaussians:
    """Random Gaussians around the origin; `kind` is one of KINDS."""
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


def spheres(x: list[float], size: list[float], opacity: float = 0.5) -> Gaussians:
    """Round Gaussians on the x axis; number k has the constant coefficient k."""
    n = len(x)
    means = torch.zeros(3, n)
    means[0] = torch.tensor(x)
    return Gaussians(
        means,
        torch.log(torch.tensor(size)).expand(3, n).clone(),
        torch.tensor([[1.0], [0], [0], [0]]).expand(4, n).clone(),
        torch.full((n,), float(np.log(opacity / (1 - opacity)))),
        torch.arange(n, dtype=torch.float32).expand(1, 3, n).clone(),
    )


def white_dot(depth: float, deviation: float, opacity: float = 0.5) -> Gaussians:
    """One round Gaussian of radiance 1 on the z axis."""
    dot = spheres([0.0], [deviation], opacity)
    dot.means[2] = depth
    dot.sh[:] = 0.5 / SH_DC
    return dot


def leaves_of(g: Gaussians, dtype: torch.dtype = torch.float32) -> dict[str, torch.Tensor]:
    """Copies of all tensors that require gradients."""
    return {name: tensor.to(dtype).clone().requires_grad_() for name, tensor in g.tensors()}


def equal(a: Gaussians, b: Gaussians) -> bool:
    """Whether two sets agree in every number, wherever their harmonics are."""
    pairs = zip(a.all_turning().tensors(), b.all_turning().tensors(), strict=True)
    return all(torch.equal(x, y) for (_, x), (_, y) in pairs)
