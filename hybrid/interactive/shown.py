"""What the window receives for a request."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.frame.frame import Frame
from hybrid.interactive.request import Request


@dataclass(frozen=True)
class Shown:
    """An image for the window, and what it was made of.

    Attributes:
        image: (H, W, 3) sRGB.
        request: what was asked for, with the settings that were chosen for it.
        frame: the hybrid frame behind the image.
        paths: traced for it.
        milliseconds: of each pass that was run for it, and in total.
        path_traced_spp: samples per pixel of the path-traced frame; 0 if the view needs none.
        finished: whether the same request would yield no better image.
    """

    image: NDArray[np.uint8]
    request: Request
    frame: Frame
    paths: int
    milliseconds: dict[str, float]
    path_traced_spp: int
    finished: bool

    @property
    def spp(self) -> float:
        """Mean samples per pixel of the disc, including those of earlier frames."""
        return self.frame.fovea.samples.mean_count()
