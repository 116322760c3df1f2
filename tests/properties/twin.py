"""A plain float64 twin of the composite that also tells where its definition jumps.

Three steps of the definition are discontinuous, and a value that rounding moves across one of them changes a
pixel by more than rounding alone would: an alpha at 1/255, below which a splat is skipped; two depths that
the sort takes to be equal; and the end of a pixel that transmits less than 1e-4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.fovea.foveation import Foveation
from splat.model.gaussians import Gaussians
from tests.properties.random_scenes import RandomScene
from tests.splat.raster import reference

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

PIXEL_FILTER = 0.1
_MINIMUM_ALPHA, _MAXIMUM_ALPHA = 1 / 255, 0.99
# How near, relatively, an alpha must be to 1/255 and two depths to each other for rounding to decide. Depths
# that agree to one part in 100,000 keep the order of their indices; twice that, for their own rounding.
_NEAR_ALPHA, _NEAR_DEPTH = 1e-3, 2e-5
# A pixel stops at 1e-4, or as soon as all pixels of its block do; with room for rounding.
_STOP = 1.01e-4


@dataclass(frozen=True)
class TwinImage:
    """An image in float64, and where it is about to jump.

    Attributes:
        radiance: (H, W, 3).
        jumps: (H, W) bool by cause: `cut`, `order`, `stop`.
    """

    radiance: Floats
    jumps: dict[str, Flags]


def rendered(gaussians: Gaussians, camera: Camera) -> TwinImage:
    """The splats' image."""
    with torch.no_grad():
        splats = reference.project(reference.double(gaussians), camera, PIXEL_FILTER)
    found = {name: value.numpy() for name, value in splats.items()}
    order = np.argsort(found["depth"], kind="stable")
    pixels = camera.pixel_centres().T  # (2, P)
    d = pixels[:, None] - found["centre"][:, order, None]  # (2, N, P)
    q = np.einsum("inp,nij,jnp->np", d, found["inverse"][order], d)
    raw = found["opacity"][order, None] * np.exp(-q / 2)
    alpha = np.where(raw >= _MINIMUM_ALPHA, np.minimum(raw, _MAXIMUM_ALPHA), 0)
    after = np.cumprod(1 - alpha, axis=0)
    before = np.concatenate([np.ones((1, alpha.shape[1])), after[:-1]])
    radiance = (before * alpha).T @ found["colour"][:, order].T
    shape = camera.height, camera.width
    jumps = {
        "cut": (np.abs(raw / _MINIMUM_ALPHA - 1) < _NEAR_ALPHA).any(axis=0),
        "order": _about_to_swap(found["depth"][order], alpha > 0),
        "stop": after[-1] < _STOP,
    }
    return TwinImage(radiance.reshape(*shape, 3), {name: flag.reshape(shape) for name, flag in jumps.items()})


def _about_to_swap(depth: Floats, seen: Flags) -> Flags:
    """(P,) pixels in which two splats, sorted by depth (N,) and visible where `seen` (N, P), nearly tie."""
    swaps = np.zeros(seen.shape[1], dtype=bool)
    for n in range(len(depth) - 1):
        last = np.searchsorted(depth, depth[n] * (1 + _NEAR_DEPTH), side="right")
        if last > n + 1:
            swaps |= seen[n] & seen[n + 1 : last].any(axis=0)
    return swaps


def blended(periphery: Floats, fovea: NDArray[np.float32], foveation: Foveation, pixels: NDArray) -> Floats:
    """The composite of float64 images: the definition of the blend, pixel by pixel."""
    height, width = periphery.shape[:2]
    gaze_x, gaze_y = foveation.gaze.pixel(width, height)
    y, x = np.divmod(pixels.astype(np.int64), width)
    radius = np.hypot(x + 0.5 - gaze_x, y + 0.5 - gaze_y)
    outer, inner = foveation.fov_a / 100 * height, foveation.fov_b / 100 * height
    furthest = [max(at, side - at) - 0.5 for at, side in ((gaze_x, width), (gaze_y, height))]
    weight = np.ones_like(radius)
    if outer > inner:
        weight = np.clip((outer - radius) / (outer - inner), 0, 1)
    # Beyond the furthest pixel, what is left to the splats fades over a fifth of its distance.
    faded = np.clip((outer / np.hypot(*furthest) - 1) / 0.2, 0, 1) if np.hypot(*furthest) > inner else 1.0
    weight = weight + (1 - weight) * faded
    composite = periphery.reshape(-1, 3).copy()
    composite[pixels] = (1 - weight[:, None]) * composite[pixels] + weight[:, None] * fovea
    return composite.reshape(periphery.shape)


def composite(scene: RandomScene) -> TwinImage:
    """The whole composite; a jump counts only where the splats show."""
    splats = rendered(scene.gaussians, scene.camera)
    region = scene.foveation.region(scene.camera.width, scene.camera.height)
    image = blended(splats.radiance, scene.fovea, scene.foveation, region.pixels)
    shows = region.weight_image() < 1
    return TwinImage(image, {name: flag & shows for name, flag in splats.jumps.items()})
