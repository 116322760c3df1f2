"""The sky among Gaussians: where rays hit nothing and yet see light.

It lies at one distance, so far away that no viewer sees it move. Surfaces farther away than that are drawn
there as well.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from compose.camera.camera import sphere_directions
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance, sh_count
from splat.model.points import Floats

# In units of a place (compose.camera.coordinate_systems), 25,000 times the median distance of what is seen:
# seven times that median distance away, a viewer sees the sky moved by half a pixel of 1,920 over 60 degrees.
SKY_DISTANCE = 1e5
# Share of the median radiance of a frame below which nothing is drawn.
_DARK = 1e-3
# Share of dark pixels, among those that hit nothing, above which there is no sky, but a void.
_MOST_DARK = 0.8
# Pixels around those that see nothing at all that are not the sky: what is bright there belongs to an edge.
_EDGE = 2
# Directions of the whole sphere in which there is a Gaussian behind all others if they show the sky.
_DIRECTIONS = 2000
_SPACING = float(np.sqrt(4 * np.pi / _DIRECTIONS))  # radians
# Their distance: even those beside each other in a frame are sorted by depth, which falls with the angle.
_BEHIND = 1.25
# Standard deviation as a share of the spacing, and opacity: together they hide what is behind.
_COVERING, _OPACITY = 0.75, 0.95
_FLATNESS = 0.2
# Seen directions whose mean colour each gets.
_ALIKE = 24
# Share of seen colours above which they are that of the sun, which shines from one direction only.
_SUN = 0.98


def shows_sky(radiance: NDArray[np.float32], distance: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mask (H, W) of the pixels that see light and hit nothing: their distance along the ray is inf."""
    missed = np.isinf(distance)
    if not missed.any():
        return missed
    brightness = radiance.max(axis=2)
    lit = brightness > 0
    dark = brightness <= (_DARK * np.median(brightness[lit]) if lit.any() else 0)
    if dark[missed].mean() > _MOST_DARK:
        return np.zeros_like(missed)
    nothing = binary_dilation(missed & dark, np.ones((2 * _EDGE + 1,) * 2))
    return np.asarray(missed & ~nothing)


def whole_sky(sky: Floats, radiance: NDArray[np.float32], surface: Floats, degree: int) -> Gaussians:
    """Gaussians behind all others in every direction of the sky, in the mean colour of what is next to it.

    A direction that no frame shows belongs to the sky if the nearest one that is seen does. Frames show the
    sky in unit directions (M, 3), its linear radiance (M, 3) there, and surfaces in unit directions (N, 3).
    """
    directions = sphere_directions(_DIRECTIONS)
    distance, near = cKDTree(sky).query(directions, k=np.arange(1, min(_ALIKE, len(sky)) + 1))
    if len(surface):
        # What stands before the sky in one view may not do so in another.
        belongs = distance[:, 0] < cKDTree(surface).query(directions)[0] + _SPACING
        directions, near = directions[belongs], near[belongs]
    seen = perceptual_from_radiance(torch.from_numpy(radiance).clamp(min=0))
    seen = torch.minimum(seen, seen.quantile(_SUN, dim=0))
    colour = seen[torch.from_numpy(near)].mean(dim=1).T
    sizes = _BEHIND * SKY_DISTANCE * _SPACING * _COVERING * np.array([1, 1, _FLATNESS])
    log_scales = np.broadcast_to(np.log(sizes), directions.shape)
    return discs(_BEHIND * SKY_DISTANCE * directions, log_scales, directions, colour, _OPACITY, degree)


def discs(
    means: Floats, log_scales: Floats, normals: Floats, colour: torch.Tensor, opacity: float, degree: int
) -> Gaussians:
    """N Gaussians that look alike from everywhere and are flat: their third axis lies along the normal.

    Means, log-scales and normals are (N, 3), the colour is perceptual radiance (3, N); of the spherical
    harmonics, only the constant one is set.
    """
    sh = torch.zeros(sh_count(degree), 3, len(means))
    sh[0] = (colour - 0.5) / SH_DC
    parts = means, log_scales, rotation_to(normals)
    rows = [torch.from_numpy(np.ascontiguousarray(part.T, dtype=np.float32)) for part in parts]
    return Gaussians(*[*rows, torch.full((len(means),), opacity_logit(opacity)), sh])


def opacity_logit(opacity: float) -> float:
    """The inverse of the sigmoid."""
    return float(np.log(opacity / (1 - opacity)))


def rotation_to(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Quaternions (M, 4) that turn the z axis into the normals (M, 3); identity for a zero normal."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(length > 1e-6, normals / np.maximum(length, 1e-6), [0.0, 0.0, 1.0])
    # Half-way quaternion (1 + z.n, z x n); for n = -z any half turn about a horizontal axis works.
    quaternion = np.stack([1 + unit[:, 2], -unit[:, 1], unit[:, 0], np.zeros(len(unit))], axis=1)
    quaternion[unit[:, 2] < -1 + 1e-6] = [0.0, 1.0, 0.0, 0.0]
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
