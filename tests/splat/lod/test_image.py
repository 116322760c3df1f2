"""Images are views of padded buffers."""

from __future__ import annotations

import numpy as np

from splat.lod.layer_images import SplatImage, black_image
from tests.splat.lod.views import frame_camera


def test_padding_and_further_channels_are_cut_off(arrays):
    """3 x 2 pixels in a buffer of 4 x 3 with 5 channels."""
    buffer = np.arange(4 * 3 * 5, dtype=np.float32)
    image = SplatImage(arrays, arrays.plain.Float(buffer), 3, 2, 4, 5).numpy()
    assert image.shape == (2, 3, 3)
    assert image[0, 0].tolist() == [0, 1, 2]
    assert image[0, 2].tolist() == [10, 11, 12]
    assert image[1, 0].tolist() == [20, 21, 22]


def test_a_black_image_has_the_cameras_size(arrays):
    black = black_image(arrays, frame_camera(33, 20), 7)
    assert black.numpy().shape == (20, 33, 3)
    assert (black.numpy() == 0).all()
    assert (black.stride, black.channels, black.nodes) == (48, 3, 7)
