"""Layer images of one view that are drawn once and composited again with other weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from splat.lod.compositing import composite
from splat.lod.image import SplatImage, black_image
from splat.lod.layer_images import NYQUIST, Lattice, LayerImage, covered_cells, pack_atlas
from splat.lod.renderer import ForestRenderer
from splat.raster.tiles import TileGrid


class CachedLayerImages:
    """Layer images of one view, each drawn over the whole frame.

    Args:
        renderer: draws the forest.
        camera: the view.
        steps: layer and rate of each image.
    """

    def __init__(self, renderer: ForestRenderer, camera: Camera, steps: Sequence[tuple[int, int]]):
        grid = TileGrid(camera.width, camera.height)
        corners = (grid.rows + 1, grid.columns + 1)
        weight = np.ones(corners, np.float32)
        images = [LayerImage(layer, rate, weight) for layer, rate in steps]
        self._entries = pack_atlas(images, grid.mask(None))
        self._arrays, self._camera = renderer.arrays, camera
        self._atlas = renderer.draw_atlas(camera, self._entries, np.full(corners, NYQUIST, np.float32))

    def composite(self, weights: Sequence[Lattice], wanted: NDArray[np.bool_]) -> SplatImage:
        """The frame with the given weights.

        Args:
            weights: of each image (rows + 1, columns + 1), at the corners of cells of TILE pixels; they sum
                to 1 wherever a cell is wanted.
            wanted: (rows, columns) bool, cells that are composited at all.
        """
        entries = [
            replace(entry, image=replace(entry.image, weight=weight), cells=cells)
            for entry, weight in zip(self._entries, weights, strict=True)
            if (cells := covered_cells(weight) & wanted).any()
        ]
        if not entries or not self._atlas.nodes:
            return black_image(self._arrays, self._camera, self._atlas.nodes)
        return composite(self._arrays, entries, self._atlas, self._camera)
