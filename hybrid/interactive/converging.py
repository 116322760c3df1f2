"""The whole frame, path-traced sample by sample while the camera stands still."""

from __future__ import annotations

from functools import cached_property

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.image.colour import Image
from hybrid.measure.reference import REFERENCE_SEED
from pathtrace.trace.film import frame_positions, interleaved, pixel_positions
from pathtrace.trace.image import TracedImage, auxiliary_images
from pathtrace.trace.tracer import Tracer, auxiliary_spp

# Each step traces one pixel of every 4 x 4 block: the window stays responsive, and the image sharpens
# everywhere at once. The order is that of a dither matrix (Bayer 1973).
_SIDE = 4
_ORDER = (0, 10, 2, 8, 5, 15, 7, 13, 1, 11, 3, 9, 4, 14, 6, 12)
# No screen shows a difference beyond this many samples per pixel.
_MOST_SAMPLES = 1024


class ConvergingFrame:
    """Path-traced radiance of one view, which gets better with every step.

    Args:
        tracer: of the scene.
        camera: the view.
        stand_in: (H, W, 3) radiance for pixels that have no sample yet.

    Attributes:
        camera: the view.
    """

    def __init__(self, tracer: Tracer, camera: Camera, stand_in: Image):
        self._tracer, self.camera = tracer, camera
        # One row per pixel, row-major: (H * W, 3) and (H * W,).
        self._stand_in = stand_in.reshape(-1, 3)
        self._sums = np.zeros_like(self._stand_in)
        self._counts = np.zeros(len(self._sums), dtype=np.float32)
        self._steps = 0

    @property
    def samples(self) -> int:
        """Samples that every pixel has."""
        return self._steps // len(_ORDER)

    @property
    def complete(self) -> bool:
        """Whether further samples would make no visible difference."""
        return self.samples >= _MOST_SAMPLES

    def refine(self) -> int:
        """Adds one sample to a sixteenth of the pixels.

        Returns:
            Number of paths traced.
        """
        # The pixels of this step have `samples` samples so far.
        samples, in_block = self.samples, _ORDER[self._steps % len(_ORDER)]
        pixels = _one_per_block(self.camera, in_block // _SIDE, in_block % _SIDE)
        self._steps += 1
        if not len(pixels):
            return 0
        positions = pixel_positions(mi.UInt32(pixels), self.camera.width)
        # Not the seeds of the frames that this one is compared with.
        seed = REFERENCE_SEED + self._steps
        traced = self._tracer.trace(self.camera, positions, 1, seed, samples, REFERENCE_SEED)
        self._sums[pixels] += interleaved(traced.radiance)
        self._counts[pixels] += 1
        return len(pixels)

    def image(self) -> Image:
        """(H, W, 3) mean radiance of all samples."""
        counts = self._counts[:, None]
        mean = np.where(counts > 0, self._sums / np.maximum(counts, 1), self._stand_in)
        return mean.reshape(self.camera.height, self.camera.width, 3)

    def denoised(self) -> Image:
        """(H, W, 3) the same, denoised: the noise of few samples would hide every difference."""
        return TracedImage(self.image(), *self._auxiliary).denoised(quick=True)

    @cached_property
    def _auxiliary(self) -> tuple[Image, Image]:
        """Albedo and normal, (H, W, 3) each."""
        positions = frame_positions(self.camera)
        return auxiliary_images(
            self._tracer, self.camera, positions, self.camera.width, auxiliary_spp(1), REFERENCE_SEED
        )


def _one_per_block(camera: Camera, row: int, column: int) -> NDArray[np.uint32]:
    """(N,) row-major indices of the pixels at a row and column, 0 to 3, of their 4 x 4 block."""
    rows = np.arange(row, camera.height, _SIDE, dtype=np.uint32)
    columns = np.arange(column, camera.width, _SIDE, dtype=np.uint32)
    return (rows[:, None] * np.uint32(camera.width) + columns).ravel()
