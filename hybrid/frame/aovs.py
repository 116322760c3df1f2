"""The AOVs of a frame: the named images of its EXR file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.eye.detail import DetailMap
from compose.eye.gaze import eccentricity
from compose.fusion.parents import PARENTS
from compose.image.colour import Image
from hybrid.frame.fovea import FoveaImage
from hybrid.frame.settings import FrameSettings


def aovs_of(
    composite: Image, settings: FrameSettings, detail: DetailMap, fovea: FoveaImage
) -> dict[str, NDArray[np.float32]]:
    """The AOVs that follow from the parts of a frame, (H, W, 3) or (H, W) each.

    Returns:
        composite (also without a name); fovea as it was blended; path-traced, the mean of the samples, and
        variance, of that mean (inf where there is only one sample); denoised, unless raw; if fused, the share
        of each parent (fusion.traced, fusion.denoised, fusion.splat); weight of the fovea; eccentricity in
        degrees on the display; level (1 to L); rate (log2 of pixels per sample along each axis).
    """
    viewer = settings.display.viewer(fovea.disc.width, fovea.disc.height)
    return {
        "": composite,
        "composite": composite,
        **(_of_disc(fovea) if fovea.disc.count else {}),
        "eccentricity": eccentricity(viewer, settings.gaze),
        "level": detail.per_pixel(detail.drawn_level),
        "rate": detail.per_pixel(detail.drawn_rate),
    }


def _of_disc(fovea: FoveaImage) -> dict[str, NDArray[np.float32]]:
    """The AOVs of a frame of which any pixel is path-traced."""
    image_of = fovea.disc.frame_image
    found = {
        "fovea": image_of(fovea.radiance),
        "path-traced": image_of(fovea.samples.radiance),
        "variance": image_of(fovea.samples.variance()),
        "weight": image_of([fovea.disc.weights])[..., 0],
    }
    if fovea.denoised is not None:
        found["denoised"] = image_of(fovea.denoised)
    if fovea.weights is not None:
        shares = image_of(fovea.weights)
        found |= {f"fusion.{name}": shares[..., i] for i, name in enumerate(PARENTS)}
    return found
