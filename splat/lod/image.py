"""An image of a forest on the device."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.device import DeviceImage
from splat.raster.tiles import TileGrid


@dataclass(frozen=True)
class SplatImage(DeviceImage):
    """An image of a forest, black where nothing is drawn.

    Attributes:
        nodes: Gaussians drawn, those in several layer images counted in each.
    """

    nodes: int = 0


def black_image(arrays: Arrays, camera: Camera, nodes: int = 0) -> SplatImage:
    """A black image of a camera's size."""
    grid = TileGrid(camera.width, camera.height)
    black = dr.zeros(arrays.plain.Float, grid.padded_width * grid.padded_height * 3)
    return SplatImage(arrays, black, camera.width, camera.height, grid.padded_width, nodes=nodes)
