"""Trains Gaussians on views of others, as a script for gsplat does; takes half a minute on a CPU.

    python examples/gsplat_training.py [STEPS]

With `from gsplat import rasterization` instead, it runs on gsplat. Prints the loss and the PSNR of views that
were not trained on.
"""

from __future__ import annotations

import sys

import torch
from torch.nn import functional

from splat import rasterization

SIZE, VIEWS, COUNT, SH_DEGREE = 64, 12, 600, 1
DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def gaussians(count: int, scale: float, seed: int) -> dict[str, torch.Tensor]:
    """Random Gaussians in a ball, as they are trained: logarithms of scales, logits of opacities."""
    generator = torch.Generator().manual_seed(seed)
    direction = functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    values = {
        "means": direction * torch.rand(count, 1, generator=generator),
        "quats": torch.randn(count, 4, generator=generator),
        "scales": torch.full((count, 3), scale).log() + 0.3 * torch.randn(count, 3, generator=generator),
        "opacities": torch.rand(count, generator=generator),
        "sh": 0.8 * torch.randn(count, (SH_DEGREE + 1) ** 2, 3, generator=generator),
    }
    return {name: value.to(DEVICE) for name, value in values.items()}


def cameras(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """World-to-camera matrices (count, 4, 4) on a circle around the ball, and intrinsics (count, 3, 3)."""
    angle = torch.arange(count) * (2 * torch.pi / count)
    zero, one = torch.zeros(count), torch.ones(count)
    rows = [angle.cos(), zero, angle.sin(), zero, zero, one, zero, zero]
    rows += [-angle.sin(), zero, angle.cos(), 4 * one, zero, zero, zero, one]
    K = torch.tensor([[1.6 * SIZE, 0, SIZE / 2], [0, 1.6 * SIZE, SIZE / 2], [0, 0, 1]])
    return torch.stack(rows, dim=-1).reshape(count, 4, 4).to(DEVICE), K.repeat(count, 1, 1).to(DEVICE)


def render(splats: dict[str, torch.Tensor], viewmats: torch.Tensor, Ks: torch.Tensor) -> tuple:
    """Images, opacities and what else is known of Gaussians in front of white."""
    return rasterization(
        splats["means"],
        splats["quats"],
        splats["scales"].exp(),
        splats["opacities"].sigmoid(),
        splats["sh"],
        viewmats,
        Ks,
        SIZE,
        SIZE,
        sh_degree=SH_DEGREE,
        backgrounds=torch.ones(len(viewmats), 3, device=DEVICE),
        packed=False,
        rasterize_mode="antialiased",
    )


def main(steps: int = 300) -> None:
    """Trains on all views but every fourth one."""
    viewmats, Ks = cameras(VIEWS)
    targets = render(gaussians(60, 0.15, seed=1), viewmats, Ks)[0].detach()
    held_out = torch.arange(VIEWS) % 4 == 0
    splats = {name: value.requires_grad_() for name, value in gaussians(COUNT, 0.06, seed=2).items()}
    rates = {"means": 5e-3, "quats": 1e-2, "scales": 2e-2, "opacities": 5e-2, "sh": 2e-2}
    optimizer = torch.optim.Adam([{"params": [splats[name]], "lr": rate} for name, rate in rates.items()])
    train = (~held_out).nonzero()[:, 0]
    pulls = torch.zeros(COUNT, device=DEVICE)
    for step in range(steps):
        view = train[step % len(train)][None]
        image, _, meta = render(splats, viewmats[view], Ks[view])
        meta["means2d"].retain_grad()
        loss = functional.l1_loss(image, targets[view])
        optimizer.zero_grad()
        loss.backward()
        # What strategies of densification look at.
        pulls += meta["means2d"].grad.norm(dim=-1).sum(dim=0)
        optimizer.step()
        if step % 50 == 0 or step == steps - 1:
            with torch.no_grad():
                error = (
                    (render(splats, viewmats[held_out], Ks[held_out])[0] - targets[held_out]).square().mean()
                )
            print(f"step {step:4d}: loss {loss.item():.4f}, PSNR {-10 * error.log10().item():.2f} dB")
    print(f"mean gradient on the screen {(pulls / steps).mean().item():.1e} per px")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
