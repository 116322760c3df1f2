"""What draws attention in an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter

from compose.image.colour import Image, srgb_from_radiance

# Width of the blur that joins the responses of one object, as a fraction of the image's longer side
# (Hou et al. 2012 use 0.045).
_BLUR = 0.045


def saliency(coarse: Image) -> NDArray[np.float32]:
    """(H, W) in 0..1 of a coarse image (H, W, 3) in linear radiance; about 64 pixels across suffice.

    The image signature (Hou, Harel and Koch 2012): the sign of the discrete cosine transform keeps what is
    sparse in the image and drops what is everywhere. It is taken of intensity and of two opponent channels;
    of intensity alone it would be blind to colour.
    """
    red, green, blue = np.moveaxis(srgb_from_radiance(coarse).astype(np.float64), -1, 0)
    channels = [(red + green + blue) / 3, red - green, blue - (red + green) / 2]
    response = np.zeros(red.shape)
    for channel in channels:
        reconstructed = idctn(np.sign(dctn(channel, norm="ortho")), norm="ortho")
        response += gaussian_filter(reconstructed**2, _BLUR * max(red.shape))
    low, high = response.min(), response.max()
    if high - low <= 1e-12 * max(high, 1e-30):
        return np.zeros(red.shape, dtype=np.float32)
    return ((response - low) / (high - low)).astype(np.float32)
