"""The blend of images in host memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compose.fovea.disc import blend
from compose.fovea.foveation import FoveaRegion
from tests.available import available_arrays
from tests.compose.arrays_of import channels, image_on


def blended(
    periphery: NDArray[np.float32], fovea: NDArray[np.float32], region: FoveaRegion
) -> NDArray[np.float32]:
    """(H, W, 3) composite by the kernels, of an image (H, W, 3) and radiance (D, 3) of a region's pixels."""
    arrays = available_arrays()
    image, _ = blend(image_on(arrays, periphery), channels(arrays, fovea), region.disc(arrays))
    return np.array(image.numpy())


def image_of(region: FoveaRegion, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W, C) image of values (D, C) of a region's pixels, 0 elsewhere."""
    image = np.zeros((region.height * region.width, values.shape[1]), dtype=np.float32)
    image[region.pixels] = values
    return image.reshape(region.height, region.width, -1)


def weight_image(region: FoveaRegion) -> NDArray[np.float32]:
    """(H, W) weights of the kernels."""
    disc = region.disc(available_arrays())
    return disc.frame_image([disc.weights])[..., 0]
