"""Converged radiance of a view, and an honest estimate of the error that is left in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from pathtrace.trace.film import frame_positions
from pathtrace.trace.image import TracedImage, auxiliary_images, radiance_image
from pathtrace.trace.tracer import Tracer, auxiliary_spp

# Far from the seeds of frames, whose noise would otherwise be that of the reference.
REFERENCE_SEED = 1_000_003
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
        errors: (H, W) unbiased estimates of its squared error in sRGB, noisy and at times negative.
    """

    radiance: Image
    halves: tuple[Image, Image]
    errors: NDArray[np.float32]

    def squared_error(self, where: NDArray[np.bool_] | None = None) -> float:
        """In sRGB, mean over some pixels or all: the upper end of its confidence interval."""
        errors = self.errors[where] if where is not None else self.errors.ravel()
        upper = errors.mean(dtype=np.float64) + 2 * errors.std(dtype=np.float64) / np.sqrt(errors.size)
        # The variance between the halves alone is there for certain.
        between = srgb_from_radiance(self.halves[0]) - srgb_from_radiance(self.halves[1])
        squares = (between if where is None else between[where]) ** 2
        return max(float(upper), 0.25 * float(squares.mean(dtype=np.float64)))

    def psnr(self, where: NDArray[np.bool_] | None = None) -> float:
        """Of the reference itself against the truth, in dB: no frame can be told to be better than that."""
        return float(-10 * np.log10(max(self.squared_error(where), 1e-12)))


def reference(tracer: Tracer, camera: Camera, spp: int | NDArray[np.int64], seed: int) -> Reference:
    """Traces a reference.

    Args:
        tracer: of the scene.
        camera: the view.
        spp: samples per pixel in all, at least 4; the same for all, or (H * W,).
        seed: same seed, same reference.

    Raises:
        ValueError: there are fewer samples than independent parts.
    """
    if np.min(spp) < _PARTS:
        raise ValueError(f"a reference needs at least {_PARTS} samples per pixel")
    positions, size = frame_positions(camera), (camera.height, camera.width)
    halves, parts = [], []
    for half in range(2):
        first, last = (spp * (2 * half + part) // _PARTS for part in (0, 2))
        middle = spp * (2 * half + 1) // _PARTS
        seeds = np.random.SeedSequence([seed, half]).generate_state(2)
        raw = [
            radiance_image(tracer, camera, positions, camera.width, count, int(part_seed))
            for count, part_seed in zip((middle - first, last - middle), seeds, strict=True)
        ]
        auxiliary = auxiliary_images(
            tracer, camera, positions, camera.width, auxiliary_spp(int(np.max(spp))), int(seeds[0])
        )
        share = np.broadcast_to((last - middle) / (last - first), size[0] * size[1])
        mean = raw[0] + (raw[1] - raw[0]) * share.reshape(*size, 1).astype(np.float32)
        halves.append(TracedImage(mean, *auxiliary).denoised())
        parts.append(raw)
    return judged(halves, parts)


def judged(halves: list[Image], parts: list[list[Image]]) -> Reference:
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
    error = (0.5 * (errors[0] + errors[1]) - 0.25 * between).mean(axis=-1)
    return Reference(radiance, (halves[0], halves[1]), error.astype(np.float32))
