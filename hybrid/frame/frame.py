"""A rendered frame and its parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.eye.detail import DetailMap
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image
from hybrid.frame.disc import Underlay
from hybrid.frame.fovea import FoveaPicture


@dataclass(frozen=True)
class Frame:
    """One frame and its parts.

    Attributes:
        composite: (H, W, 3) linear radiance, what the viewer sees.
        periphery: (H, W, 3) the splats; black in tiles that the fovea hides.
        detail: what the viewer resolves where.
        nodes_drawn: Gaussians in the periphery, those of several pictures counted in each.
        fovea: the disc and what it was made of.
        under: the splats under the disc, of a fused one.
        plan: which pixels that is, and the weights of the blend; of a raw fovea, those that have samples.
        milliseconds: per pass (plan, detail, splat, under, trace, fovea, blend) and in all (total).
    """

    composite: Image
    periphery: Image
    fovea: FoveaPicture
    underlay: Underlay | None
    region: FoveaRegion
    detail: DetailMap
    nodes_drawn: int
    milliseconds: dict[str, float]

    def of_disc(self, values: NDArray[np.float32]) -> Image:
        """(H, W, C) an image of the plan's pixels' values (D, C), black elsewhere."""
        image = np.zeros((self.region.height * self.region.width, values.shape[1]), dtype=np.float32)
        image[self.region.pixels] = values
        return image.reshape(self.region.height, self.region.width, -1)
