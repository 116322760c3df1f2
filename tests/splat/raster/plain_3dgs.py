"""A plain float64 twin of 3D Gaussian splatting in torch: every pixel against every Gaussian.

Written from Kerbl et al. (2023), section 4 and appendices, and the rules that trainers share: colours are
max(0, harmonics + 0.5), the 2D covariance gets 0.3 px^2, tangents end at 1.3 times the half field of view,
alpha ends at 0.99 and counts from 1/255 on. The picture is display-encoded.
"""

from __future__ import annotations

import torch

from compose.camera.camera import Camera
from splat.model.gaussians import Gaussians
from tests.splat.raster.reference import harmonics, rotation_matrix

# Pixels that are blended at once: of them, all Gaussians are in memory.
_PIXELS = 512


def picture(g: Gaussians, camera: Camera, every: int = 1) -> torch.Tensor:
    """(H, W, 3) float64 display-encoded picture, not clipped at 1; torch can differentiate it.

    Of every so many rows and columns.
    """
    means, log_scales, rotations, logits, sh = (tensor.double() for _, tensor in g.all_turning().tensors())
    world = torch.from_numpy(camera.world_to_camera)
    local = world[:3, :3] @ means + world[:3, 3:]
    ahead = torch.nonzero(local[2].detach() > 0.01)[:, 0]
    ahead = ahead[torch.argsort(local[2, ahead].detach(), stable=True)]
    x, y, z = local[:, ahead]
    half = camera.width / (2 * camera.fx), camera.height / (2 * camera.fy)
    across, down = ((t / z).clamp(-1.3 * limit, 1.3 * limit) for t, limit in zip((x, y), half, strict=True))
    none = torch.zeros_like(z)
    jacobian = torch.stack(
        [
            torch.stack([camera.fx / z, none, -camera.fx * across / z]),
            torch.stack([none, camera.fy / z, -camera.fy * down / z]),
        ]
    ).permute(2, 0, 1)
    factor = rotation_matrix(rotations[:, ahead]) @ torch.diag_embed(log_scales[:, ahead].exp().T)
    projected = jacobian @ world[:3, :3] @ factor
    covariance = projected @ projected.transpose(1, 2) + 0.3 * torch.eye(2, dtype=torch.float64)
    direction = means[:, ahead] - torch.from_numpy(camera.position.copy())[:, None]
    basis = harmonics(len(sh), direction / direction.norm(dim=0))
    colour = (0.5 + torch.einsum("kcn,kn->nc", sh[..., ahead], basis)).clamp(min=0)
    centre = torch.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], dim=-1)
    splats = centre, torch.linalg.inv(covariance), torch.sigmoid(logits[ahead]), colour
    pixels = torch.from_numpy(camera.pixel_centres()).reshape(camera.height, camera.width, 2)[
        ::every, ::every
    ]
    rows = [_blended(*splats, some) for some in pixels.reshape(-1, 2).split(_PIXELS)]
    return torch.cat(rows).reshape(*pixels.shape[:2], 3)


def _blended(
    centre: torch.Tensor,
    precision: torch.Tensor,
    opacity: torch.Tensor,
    colour: torch.Tensor,
    at: torch.Tensor,
) -> torch.Tensor:
    """(P, 3) colours of pixels at (P, 2) from N splats, from near to far."""
    x, y = (at[:, None] - centre).unbind(dim=-1)
    power = precision[:, 0, 0] * x**2 + 2 * precision[:, 0, 1] * x * y + precision[:, 1, 1] * y**2
    alpha = (opacity * (power / -2).exp()).clamp(max=0.99)
    alpha = torch.where(alpha >= 1 / 255, alpha, 0)
    in_front = torch.cumprod(1 - alpha, dim=1).roll(1, dims=1)
    in_front = torch.cat([torch.ones_like(in_front[:, :1]), in_front[:, 1:]], dim=1)
    return (alpha * in_front) @ colour
