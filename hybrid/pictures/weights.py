"""A picture of the share that each parent has in a fused fovea, pixel by pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import bytes_from_radiance
from hybrid.frame.frame import Frame


def weights_picture(frame: Frame) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB: the shares of traced, denoised and splat as red, green and blue.

    Outside the disc, the picture shows the frame itself in dark grey.

    Raises:
        ValueError: the fovea is not fused.
    """
    if frame.fovea.weights is None:
        raise ValueError("only a fused fovea has weights")
    shown = bytes_from_radiance(frame.composite).mean(axis=2, keepdims=True).repeat(3, axis=2) * 0.4
    inside = np.asarray(frame.fovea.disc.pixels)
    shares = frame.of_disc(frame.fovea.weights).reshape(-1, 3)[inside]
    shown.reshape(-1, 3)[inside] = shares * 255
    return (np.clip(shown, 0, 255) + 0.5).astype(np.uint8)
