"""A plain float64 twin of projection and rasterization in torch: every pixel against every Gaussian."""

from __future__ import annotations

import numpy as np
import torch

from compose.camera.camera import Camera
from splat.model.gaussians import SH_CUBIC, SH_DC, SH_LINEAR, SH_QUADRATIC, Gaussians


def double(g: Gaussians) -> Gaussians:
    """The same Gaussians in float64."""
    return Gaussians(**{name: tensor.double() for name, tensor in g.tensors()})


def rotation_matrix(q: torch.Tensor) -> torch.Tensor:
    """(N, 3, 3) of quaternions (4, N)."""
    w, x, y, z = q / q.norm(dim=0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row) for row in rows]).permute(2, 0, 1)  # (N, 3, 3)


def harmonics(count: int, d: torch.Tensor) -> torch.Tensor:
    """(count, N) real spherical harmonics of directions (3, N)."""
    x, y, z = d
    a, b, c = SH_QUADRATIC
    e, f, g, h, i = SH_CUBIC
    basis = [
        torch.full_like(x, SH_DC),
        -SH_LINEAR * y,
        SH_LINEAR * z,
        -SH_LINEAR * x,
        a * x * y,
        -a * y * z,
        b * (2 * z * z - x * x - y * y),
        -a * x * z,
        c * (x * x - y * y),
        -e * y * (3 * x * x - y * y),
        f * x * y * z,
        -g * y * (4 * z * z - x * x - y * y),
        h * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -g * x * (4 * z * z - x * x - y * y),
        i * z * (x * x - y * y),
        -e * x * (x * x - 3 * y * y),
    ]
    return torch.stack(basis[:count])


def radiance(perceptual: torch.Tensor) -> torch.Tensor:
    """Inverse of the sRGB curve, continued above 1."""
    value = perceptual.clamp(min=0)
    return torch.where(value <= 0.04045, value / 12.92, ((value.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)


def project(g: Gaussians, camera: Camera, low_pass: float | torch.Tensor) -> dict[str, torch.Tensor]:
    """N splats: centre (2, N), inverse (N, 2, 2), opacity (N,), colour (3, N), depth (N,).

    The low-pass is one number or (N,).
    """
    world = torch.tensor(camera.world_to_camera)
    W, t = world[:3, :3], world[:3, 3]
    local = W @ g.means + t[:, None]
    z = local[2]
    seen = z > 0.01
    safe = torch.where(seen, z, torch.ones_like(z))
    tangent = local[:2] / safe
    centre = torch.stack([camera.fx * tangent[0] + camera.cx, camera.fy * tangent[1] + camera.cy])
    limit = torch.tensor(
        [
            max(camera.cx, camera.width - camera.cx) / camera.fx,
            max(camera.cy, camera.height - camera.cy) / camera.fy,
        ]
    )
    cut = torch.clamp(tangent, -limit[:, None], limit[:, None])
    zero = torch.zeros_like(z)
    J = torch.stack(
        [
            torch.stack([camera.fx / safe, zero, -camera.fx * cut[0] / safe]),
            torch.stack([zero, camera.fy / safe, -camera.fy * cut[1] / safe]),
        ]
    ).permute(2, 0, 1)
    M = J @ W @ rotation_matrix(g.rotations) @ torch.diag_embed(g.log_scales.exp().T)
    raw = M @ M.transpose(1, 2)
    variance = torch.as_tensor(low_pass, dtype=raw.dtype)[..., None, None]
    full = raw + variance * torch.eye(2, dtype=raw.dtype)
    det_raw = torch.stack(
        [(M[:, 0, i] * M[:, 1, j] - M[:, 0, j] * M[:, 1, i]) ** 2 for i, j in ((0, 1), (0, 2), (1, 2))]
    ).sum(0)
    # From det_raw, as the determinant of `full` cancels, for a long needle even in float64.
    trace = raw[:, 0, 0] + raw[:, 1, 1]
    low_pass = torch.as_tensor(low_pass, dtype=raw.dtype)
    det = det_raw + low_pass * (trace + low_pass)
    adjugate = torch.stack([full[:, 1, 1], -full[:, 0, 1], -full[:, 1, 0], full[:, 0, 0]], dim=-1)
    compensation = torch.sqrt((det_raw / det).clamp(min=2.5e-5))
    direction = g.means - torch.tensor(camera.position)[:, None]
    direction = direction / direction.norm(dim=0)
    basis = harmonics(g.sh.shape[0], direction)
    colour = radiance(0.5 + torch.einsum("kcn,kn->cn", g.sh, basis))
    return {
        "centre": centre,
        "inverse": adjugate.reshape(-1, 2, 2) / det[:, None, None],
        "opacity": torch.sigmoid(g.opacity_logits) * compensation * seen,
        "colour": colour,
        "depth": z.detach(),
    }


def blend(splats: dict[str, torch.Tensor], width: int, height: int) -> torch.Tensor:
    """(H, W, 3) float64 of splats as `project` returns them."""
    order = torch.argsort(splats["depth"])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = torch.tensor(np.stack([x, y]))  # (2, H, W)
    image = torch.zeros(height, width, 3, dtype=torch.float64)
    transmittance = torch.ones(height, width, dtype=torch.float64)
    for m in order.tolist():
        d = pixels - splats["centre"][:, m, None, None]
        Q = splats["inverse"][m]
        q = Q[0, 0] * d[0] ** 2 + 2 * Q[0, 1] * d[0] * d[1] + Q[1, 1] * d[1] ** 2
        alpha = torch.clamp(splats["opacity"][m] * torch.exp(-q / 2), max=0.99)
        alpha = torch.where(alpha >= 1 / 255, alpha, torch.zeros_like(alpha))
        image = image + (transmittance * alpha)[..., None] * splats["colour"][:, m]
        transmittance = transmittance * (1 - alpha)
    return image


def render(g: Gaussians, camera: Camera, low_pass: float) -> torch.Tensor:
    """(H, W, 3) float64."""
    return blend(project(g, camera, low_pass), camera.width, camera.height)
