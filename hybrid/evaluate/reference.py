"""Converged radiance of a view, and an honest estimate of the error that is left in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.blend import Image, srgb_from_radiance
from compose.view import Camera
from pathtrace.denoise import denoise
from pathtrace.film import frame_positions
from pathtrace.tracer import Tracer, guide_places

# Independent parts of a reference's samples.
_PARTS = 4
# Slopes of the tone curve are taken over this much radiance.
_STEP = 1e-3


@dataclass(frozen=True)
class Reference:
    """What frames of a view are compared with.

    Attributes:
        radiance: (H, W, 3) linear, mean of `halves`.
        halves: two independent estimates, denoised each for itself.
        squared_error: mean over the frame, in sRGB; the upper end of its confidence interval.
    """

    radiance: Image
    halves: tuple[Image, Image]
    squared_error: float

    @property
    def psnr(self) -> float:
        """Of the reference itself against the truth, in dB: no frame can be told to be better than that."""
        return float(-10 * np.log10(max(self.squared_error, 1e-12)))


def reference(tracer: Tracer, camera: Camera, spp: int, seed: int) -> Reference:
    """Traces a reference.

    Args:
        tracer: of the scene.
        camera: the view.
        spp: samples per pixel in all, at least 4.
        seed: same seed, same reference.

    Raises:
        ValueError: there are fewer samples than independent parts.
    """
    if spp < _PARTS:
        raise ValueError(f"a reference needs at least {_PARTS} samples per pixel")
    positions, size = frame_positions(camera), (camera.height, camera.width)
    image = lambda channels: np.stack([c.numpy() for c in channels], axis=-1).reshape(*size, 3)  # noqa: E731
    halves, parts = [], []
    for half in range(2):
        counts = [
            (spp * (2 * half + part + 1)) // _PARTS - (spp * (2 * half + part)) // _PARTS for part in (0, 1)
        ]
        seeds = np.random.SeedSequence([seed, half]).generate_state(2)
        raw = [
            image(tracer.trace(camera, positions, count, int(part_seed)).radiance)
            for count, part_seed in zip(counts, seeds, strict=True)
        ]
        guides = tracer.guides(camera, positions, guide_places(spp), int(seeds[0]))
        mean = np.average(raw, axis=0, weights=counts).astype(np.float32)
        halves.append(denoise(mean, image(guides.albedo), image(guides.normal)))
        parts.append(raw)
    return _judged(halves, parts)


def _judged(halves: list[Image], parts: list[list[Image]]) -> Reference:
    """The mean of two halves, with its error, to which their denoiser's bias belongs.

    Against samples a and b that are independent of a denoised picture d, and of each other, the mean of
    (a - d)(b - d) is the squared error of d: their noise falls out. Each half is judged by the other's
    samples. Of the mean of both, half of the variance between them is gone.
    """
    radiance = 0.5 * (halves[0] + halves[1])
    slope = (srgb_from_radiance(radiance + _STEP) - srgb_from_radiance(radiance)) / _STEP
    errors = [
        (one - half) * (other - half) * slope**2
        for half, (one, other) in zip(halves, reversed(parts), strict=True)
    ]
    between = (halves[0] - halves[1]) ** 2 * slope**2
    error = (0.5 * (errors[0] + errors[1]) - 0.25 * between).mean(axis=-1, dtype=np.float64)
    # The variance between the halves alone is there for certain.
    least = 0.25 * float(between.mean(dtype=np.float64))
    return Reference(radiance, (halves[0], halves[1]), max(_upper(error), least))


def _upper(error: NDArray[np.float64]) -> float:
    """Upper end, at two standard errors, of the mean of (H, W) values that are noisy but independent."""
    return float(error.mean() + 2 * error.std() / np.sqrt(error.size))
