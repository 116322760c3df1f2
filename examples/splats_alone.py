"""Fits Gaussians to an image, using only the package `splat` and torch; takes a few seconds on a CPU.

    python examples/splats_alone.py [OUT.png]

Prints the loss before and after, and writes the target and the fit side by side (default: splats_alone.png).
"""

from __future__ import annotations

import sys

import numpy as np
import torch
from PIL import Image

import splat

SIZE, COUNT, STEPS = 64, 400, 100


def target_image() -> torch.Tensor:
    """(H, W, 3) linear radiance: an orange disc in front of a blue gradient."""
    y, x = torch.meshgrid(torch.linspace(-1, 1, SIZE), torch.linspace(-1, 1, SIZE), indexing="ij")
    image = torch.stack([0.1 + 0 * x, 0.2 + 0.1 * x, 0.5 - 0.3 * y], dim=-1)
    image[x**2 + y**2 < 0.4] = torch.tensor([0.9, 0.4, 0.05])
    return image


def grey_gaussians() -> splat.Gaussians:
    """Grey Gaussians at random positions on the plane z = 0."""
    generator = torch.Generator().manual_seed(0)
    means = torch.zeros(3, COUNT)
    means[:2] = 2 * torch.rand(2, COUNT, generator=generator) - 1
    return splat.Gaussians(
        means=means.requires_grad_(),
        log_scales=torch.full((3, COUNT), -2.8, requires_grad=True),
        rotations=torch.tensor([[1.0], [0.0], [0.0], [0.0]]).repeat(1, COUNT).requires_grad_(),
        opacity_logits=torch.zeros(COUNT, requires_grad=True),
        sh=torch.zeros(1, 3, COUNT, requires_grad=True),
    )


def main(path: str = "splats_alone.png") -> None:
    """Fits the Gaussians and writes the image."""
    target, gaussians = target_image(), grey_gaussians()
    pose = splat.look_at(np.array([0.0, 0.0, -3.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    centre = SIZE / 2
    camera = splat.Camera(np.linalg.inv(pose), SIZE, SIZE, 3 * centre, 3 * centre, centre, centre)
    optimizer = torch.optim.Adam([tensor for _, tensor in gaussians.tensors()], lr=0.02)
    losses = []
    for _ in range(STEPS):
        image = splat.render(gaussians, camera)
        loss = (image - target).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    print(f"loss before {losses[0]:.4f}, after {losses[-1]:.4f}")
    # Linear radiance to sRGB, approximately.
    both = torch.cat([target, image.detach()], dim=1).clamp(0, 1) ** (1 / 2.2)
    Image.fromarray((255 * both + 0.5).byte().numpy()).save(path)


if __name__ == "__main__":
    main(*sys.argv[1:2])
