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

# A sixteenth of the pixels at a time, spread over the frame: the window stays quick, and the picture sharpens
# everywhere at once. In the order of a dither matrix (Bayer 1973).
_SIDE = 4
_ORDER = (0, 10, 2, 8, 5, 15, 7, 13, 1, 11, 3, 9, 4, 14, 6, 12)
# Enough for any screen.
_MOST_SAMPLES = 1024


class ConvergingFrame:
    """Path-traced radiance of one view.

    Args:
        tracer: of the scene.
        camera: the view.
        stand_in: (H, W, 3) radiance shown where nothing was traced yet.

    Attributes:
        camera: the view.
    """

    def __init__(self, tracer: Tracer, camera: Camera, stand_in: Image):
        self._tracer, self.camera = tracer, camera
        self._stand_in = stand_in.reshape(-1, 3)
        self._sums = np.zeros_like(self._stand_in)
        self._counts = np.zeros(len(self._sums), dtype=np.float32)
        self._steps = 0

    @property
    def samples(self) -> int:
        """Per pixel, in all of them."""
        return self._steps // len(_ORDER)

    @property
    def complete(self) -> bool:
        """Whether no more samples will be taken."""
        return self.samples >= _MOST_SAMPLES

    def refine(self) -> int:
        """One more sample of some pixels; how many those are."""
        place, turn = _ORDER[self._steps % len(_ORDER)], self._steps // len(_ORDER)
        pixels = _every(self.camera, place // _SIDE, place % _SIDE)
        self._steps += 1
        if not len(pixels):
            return 0
        positions = pixel_positions(mi.UInt32(pixels), self.camera.width)
        # Other samples than those of the frame that this is compared with.
        seed = REFERENCE_SEED + self._steps
        traced = self._tracer.trace(self.camera, positions, 1, seed, turn, REFERENCE_SEED)
        self._sums[pixels] += interleaved(traced.radiance)
        self._counts[pixels] += 1
        return len(pixels)

    def image(self) -> Image:
        """(H, W, 3) the mean of all samples."""
        known = self._counts[:, None]
        mean = np.where(known > 0, self._sums / np.maximum(known, 1), self._stand_in)
        return mean.reshape(self.camera.height, self.camera.width, 3)

    def denoised(self) -> Image:
        """(H, W, 3) the same, cleaned: against the noise of few samples no difference would be seen."""
        return TracedImage(self.image(), *self._auxiliary).denoised(quick=True)

    @cached_property
    def _auxiliary(self) -> tuple[Image, Image]:
        """Albedo and normal, (H, W, 3) each."""
        positions = frame_positions(self.camera)
        return auxiliary_images(
            self._tracer, self.camera, positions, self.camera.width, auxiliary_spp(1), REFERENCE_SEED
        )


def _every(camera: Camera, row: int, column: int) -> NDArray[np.uint32]:
    """Row-major indices of one pixel of each block."""
    rows = np.arange(row, camera.height, _SIDE, dtype=np.uint32)
    columns = np.arange(column, camera.width, _SIDE, dtype=np.uint32)
    return (rows[:, None] * np.uint32(camera.width) + columns).ravel()
