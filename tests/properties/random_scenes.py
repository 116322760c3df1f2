"""Random forests of Gaussians, cameras and discs, as wide as users may have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera, camera_from_pose
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from splat.model.gaussians import SH_DC, Gaussians, sh_count


@dataclass(frozen=True)
class RandomScene:
    """What a composite is made from.

    Attributes:
        gaussians: the splats.
        camera: the view.
        foveation: gaze and radii of the disc.
        fovea: (D, 3) float32 radiance of the disc's pixels.
    """

    gaussians: Gaussians
    camera: Camera
    foveation: Foveation
    fovea: NDArray[np.float32]


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """(3, 3) a rotation, all being equally likely."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def random_camera(rng: np.random.Generator, spread: float) -> Camera:
    """A view 8 to 64 pixels wide and high, 20 to 110 degrees, `spread` deviations from the origin."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = random_rotation(rng), rng.normal(size=3) * spread
    width, height = (int(side) for side in rng.integers(8, 65, 2))
    focal = 0.5 * height / np.tan(np.radians(rng.uniform(20, 110)) / 2)
    cx, cy = np.array([width, height]) * (0.5 + rng.uniform(-0.1, 0.1, 2))
    return camera_from_pose(pose, width, height, focal, focal * rng.uniform(0.9, 1.1), cx, cy)


def random_gaussians(rng: np.random.Generator, camera: Camera, count: int, degree: int) -> Gaussians:
    """Gaussians in and around a view.

    Depths are spread over four decades, sizes on the screen from 0.1 px to a frame's width, axes over ratios
    of up to 1,000; opacities reach from invisible to opaque, radiances up to 50.
    """
    uniform = lambda low, high, *shape: rng.uniform(low, high, (*shape, count))  # noqa: E731
    depth = 10 ** uniform(-1.5, 2.5)
    x, y = uniform(-0.2, 1.2) * camera.width, uniform(-0.2, 1.2) * camera.height
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(count)]) * depth
    pose = camera.camera_to_world
    means = pose[:3, :3] @ local + pose[:3, 3:]
    pixels = np.exp(uniform(np.log(0.1), np.log(camera.width)))
    thinner = 10 ** (uniform(-3, 0, 3) * rng.integers(0, 2, (3, count)))
    log_scales = np.log(pixels * depth / camera.fy * thinner)
    perceptual = uniform(0, 1, 3) ** 3 * 5.3
    sh = rng.normal(size=(sh_count(degree), 3, count)) * 0.2
    sh[0] = (perceptual - 0.5) / SH_DC
    values = means, log_scales, rng.normal(size=(4, count)), uniform(-7, 8), sh
    return Gaussians(*(torch.from_numpy(value.astype(np.float32)) for value in values))


def random_scene(seed: int, spread: float = 2.0, most: int = 500) -> RandomScene:
    """A scene with a disc of radiance up to 10,000; same seed, same scene.

    Args:
        seed: of all its numbers.
        spread: standard deviation of the eye's coordinates; the nearest Gaussians are 0.03 away from it.
        most: Gaussians; their number is spread evenly over decades.
    """
    rng = np.random.default_rng(seed)
    camera = random_camera(rng, spread)
    count = round(np.exp(rng.uniform(0, np.log(most))))
    gaussians = random_gaussians(rng, camera, count, int(rng.integers(0, 4)))
    fov_a = rng.uniform(0, 80)
    foveation = Foveation(Gaze(*rng.uniform(-0.1, 1.1, 2)), fov_a, fov_a * rng.uniform(0, 1))
    pixels = foveation.region(camera.width, camera.height).pixels
    fovea = np.exp(rng.normal(-1, 3, (len(pixels), 3))).clip(max=1e4).astype(np.float32)
    return RandomScene(gaussians, camera, foveation, fovea)
