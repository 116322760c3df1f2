"""The underlay has the size of the frame that it is fused with."""

from __future__ import annotations

import numpy as np
import pytest

from compose.camera.camera import Camera
from hybrid.render.disc_images import Underlay
from tests.compose.arrays_of import image_on

CAMERA = Camera(np.eye(4), 8, 6, 10.0, 10.0, 4.0, 3.0)


@pytest.mark.parametrize("shape", [(8, 6, 3), (6, 7, 3), (5, 8, 3)])
def test_an_image_of_another_size_is_refused(arrays, shape):
    with pytest.raises(ValueError, match=f"the underlay is {shape[1]} x {shape[0]}, the frame 8 x 6"):
        Underlay(CAMERA, image_on(arrays, np.zeros(shape, dtype=np.float32)))
