"""The underlay shows the view of the fovea that it is fused with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.device_image import DeviceImage
from hybrid.render.disc_images import Underlay, underlay_of
from tests.compose.arrays_of import image_on

CAMERA = Camera(np.eye(4), 8, 6, 10.0, 10.0, 4.0, 3.0)


@pytest.fixture
def underlay(arrays) -> Underlay:
    return Underlay(CAMERA, black(arrays, (6, 8, 3)), 1.0)


def black(arrays: Arrays, shape: tuple[int, ...]) -> DeviceImage:
    return image_on(arrays, np.zeros(shape, dtype=np.float32))


def test_an_underlay_of_the_same_view_is_returned(underlay):
    assert underlay_of(CAMERA, underlay) is underlay
    assert underlay_of(replace(CAMERA), underlay) is underlay


@pytest.mark.parametrize("shape", [(8, 6, 3), (6, 7, 3), (5, 8, 3)])
def test_an_image_of_another_size_is_refused(arrays, shape):
    with pytest.raises(ValueError, match=f"the underlay is {shape[1]} x {shape[0]}, the frame 8 x 6"):
        Underlay(CAMERA, black(arrays, shape), 1.0)


def test_a_missing_underlay_is_refused():
    with pytest.raises(ValueError, match="requires the splats under the disc"):
        underlay_of(CAMERA, None)


def test_an_underlay_of_another_view_is_refused(underlay):
    with pytest.raises(ValueError, match="belongs to another camera"):
        underlay_of(replace(CAMERA, fx=11.0), underlay)
