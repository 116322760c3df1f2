"""Images that are fused, in host memory."""

from __future__ import annotations

import drjit as dr
import numpy as np

from compose.fusion.combination import Fusion
from compose.fusion.parents import Parents
from hybrid.render.disc_images import smooth


def fused_image(parents: Parents) -> np.ndarray:
    """(H, W, 3) the estimate from all parents."""
    fusion, (height, width) = Fusion(parents), parents.shape
    found = fusion.fused(smooth(fusion.ratio), dr.arange(parents.arrays.plain.UInt, height * width))
    return np.stack([np.array(channel) for channel in found.radiance], axis=-1).reshape(*parents.shape, 3)
