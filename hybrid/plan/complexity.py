"""How much there is to model in a scene, as its first frames show it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from compose.image.colour import Image, srgb_from_radiance

# Deviation from the mean of a group of pixels, in sRGB values, from which on the group shows detail: at
# less, a Gaussian that covers all of it is close enough.
_VISIBLE = 1 / 32
# Side in pixels of a group.
GROUP = 2
# Share of the groups that show detail in the first frames of `room`.
_ORDINARY = 0.46


def complexity_of(frames: Iterable[Image]) -> float:
    """Share of frames (H, W, 3) that shows edges and texture, over that of `room`; as of `Needs.of`."""
    return float(np.mean([detailed(frame).mean() for frame in frames]) / _ORDINARY)


def detailed(radiance: Image) -> NDArray[np.bool_]:
    """Which groups of GROUP x GROUP pixels of a frame show detail."""
    height, width = (side // GROUP * GROUP for side in radiance.shape[:2])
    image = srgb_from_radiance(radiance[:height, :width])
    groups = image.reshape(height // GROUP, GROUP, width // GROUP, GROUP, 3)
    deviation = np.abs(groups - groups.mean(axis=(1, 3), keepdims=True)).max(axis=(1, 3, 4))
    return np.asarray(deviation > _VISIBLE)
