"""Converged radiance of a view, with an unbiased estimate of the error that is left in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from hybrid.measure.image_metrics import psnr_of_error
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import TracedImage, auxiliary_images, radiance_image
from pathtrace.trace.tracer import Tracer, auxiliary_spp

# Far from the seeds of frames, whose noise must be independent of the reference's.
REFERENCE_SEED = 1_000_003
# Independent parts of a reference's samples, two per half.
_PARTS = 4
# Step in radiance over which the slope of the sRGB curve is taken.
_STEP = 1e-3


@dataclass(frozen=True)
class Reference:
    """What frames of a view are compared with: the mean, (H, W, 3) linear, of two independent halves.

    Each half is denoised on its own, or not at all. The errors (H, W) are an unbiased estimate of the
    radiance's squared error in sRGB; noisy, at times negative.
    """

    radiance: Image
    halves: tuple[Image, Image]
    errors: NDArray[np.float32]

    @staticmethod
    def of_halves(halves: tuple[Image, Image], parts: list[list[Image]]) -> Reference:
        """The mean of two halves, with its error, the bias of denoising included.

        For samples a and b, independent of an image d and of each other, the mean of (a - d)(b - d)
        is the squared error of d, because their noise cancels. Each half is compared with the samples of the
        other one. Averaging the halves removes half of their variance, which is a quarter of their squared
        difference. The parts are two independent noisy estimates (H, W, 3) from each half's samples.
        """
        radiance = 0.5 * (halves[0] + halves[1])
        slope = (srgb_from_radiance(radiance + _STEP) - srgb_from_radiance(radiance)) / _STEP
        errors = [
            (one - half) * (other - half) * slope**2
            for half, (one, other) in zip(halves, reversed(parts), strict=True)
        ]
        between = (halves[0] - halves[1]) ** 2 * slope**2
        error = (0.5 * (errors[0] + errors[1]) - 0.25 * between).mean(axis=-1)
        return Reference(radiance, halves, error.astype(np.float32))

    def squared_error(self, where: NDArray[np.bool_] | None = None) -> float:
        """Mean squared error in sRGB of the pixels (H, W) that count, at the upper end of its interval."""
        errors = self.errors[where] if where is not None else self.errors.ravel()
        upper = errors.mean(dtype=np.float64) + 2 * errors.std(dtype=np.float64) / np.sqrt(errors.size)
        # The estimate may be too low, even negative; the variance between the halves is a lower bound.
        between = srgb_from_radiance(self.halves[0]) - srgb_from_radiance(self.halves[1])
        squares = (between if where is None else between[where]) ** 2
        return max(float(upper), 0.25 * float(squares.mean(dtype=np.float64)))

    def psnr(self, where: NDArray[np.bool_] | None = None) -> float:
        """PSNR in dB of the reference against the truth: no frame can be shown to be better than that."""
        return psnr_of_error(self.squared_error(where))


def reference(
    tracer: Tracer, camera: Camera, spp: int | NDArray[np.int64], seed: int, denoised: bool = True
) -> Reference:
    """A reference of `spp` samples per pixel in total, one number or (H * W,); ValueError below 4."""
    if np.min(spp) < _PARTS:
        raise ValueError(f"a reference needs at least {_PARTS} samples per pixel")
    (first, its_parts), (second, others) = (_half(tracer, camera, spp, seed, n, denoised) for n in range(2))
    return Reference.of_halves((first, second), [its_parts, others])


def _half(
    tracer: Tracer, camera: Camera, spp: int | NDArray[np.int64], seed: int, number: int, denoised: bool
) -> tuple[Image, list[Image]]:
    """Half of a reference's samples: (H, W, 3), denoised if asked for, and as two noisy parts (H, W, 3)."""
    positions, size = frame_positions(camera), (camera.height, camera.width)
    # A quarter of the samples each; where they do not divide evenly, counts differ by one.
    first, middle, last = (spp * (2 * number + part) // _PARTS for part in range(3))
    seeds = [int(one) for one in np.random.SeedSequence([seed, number]).generate_state(2)]
    parts = [
        radiance_image(tracer, camera, positions, camera.width, count, part_seed)
        for count, part_seed in zip((middle - first, last - middle), seeds, strict=True)
    ]
    share = np.broadcast_to((last - middle) / (last - first), size[0] * size[1])
    mean = parts[0] + (parts[1] - parts[0]) * share.reshape(*size, 1).astype(np.float32)
    if not denoised:
        return mean, parts
    auxiliary = auxiliary_images(
        tracer, camera, positions, camera.width, auxiliary_spp(int(np.max(spp))), seeds[0]
    )
    return TracedImage(mean, *auxiliary).denoised(), parts
