"""An image of a forest on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.device import DeviceImage
from splat.raster.tiles import TileGrid


@dataclass
class SplatImage:
    """An image of a forest.

    Attributes:
        radiance: flat Float buffer, rows of stride x channels, of which the first three are linear radiance;
            black where nothing is drawn.
        width, height: image in pixels.
        stride, channels: width of the buffer in pixels, and floats per pixel.
        nodes: Gaussians drawn, those in several layer images counted in each.
        first_row: of the image that is in the buffer; the rows above it are black.
    """

    radiance: Any
    width: int
    height: int
    stride: int
    channels: int
    nodes: int
    first_row: int = 0

    def on_device(self, arrays: Arrays) -> DeviceImage:
        """The radiance, in the same memory."""
        size = self.width, self.height, self.stride, self.channels
        return DeviceImage(arrays, self.radiance, *size, self.first_row)

    def image(self) -> NDArray[np.float32]:
        """(H, W, 3) float32 view of the radiance, of which all rows are in the buffer."""
        assert not self.first_row, "rows are missing"
        return self.radiance.numpy().reshape(-1, self.stride, self.channels)[: self.height, : self.width, :3]


def black_image(arrays: Arrays, camera: Camera, nodes: int) -> SplatImage:
    """A black image of a camera's size."""
    grid = TileGrid(camera.width, camera.height)
    black = dr.zeros(arrays.plain.Float, grid.padded_width * grid.padded_height * 3)
    return SplatImage(black, camera.width, camera.height, grid.padded_width, 3, nodes)
