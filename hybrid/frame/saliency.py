"""Saliency of a view, which is kept while the view hardly changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.eye.lattice import CELL, at_corners
from compose.eye.saliency import saliency
from splat.lod.renderer import ForestRenderer
from splat.model.forest import Forest

# Side in pixels of the coarse image in which saliency is computed.
_COARSE = 64
# Number of Gaussians by whose motion views are compared, at most, and the share of them that counts.
_LANDMARKS = 512
_SHARE = 0.9


@dataclass(frozen=True)
class _Kept:
    """Saliency of a view.

    Attributes:
        camera: the view.
        saliency: (rows + 1, columns + 1).
        landmarks: (K, 3) points that are visible in it.
        pixels: (K, 2) where.
    """

    camera: Camera
    saliency: NDArray[np.float32]
    landmarks: NDArray[np.float64]
    pixels: NDArray[np.float64]


class ViewSaliency:
    """Computes the saliency of views from a forest's coarsest layer.

    Args:
        renderer: of the forest.
        forest: the forest.
    """

    def __init__(self, renderer: ForestRenderer, forest: Forest):
        self._renderer = renderer
        means = forest.layers[0].gaussians.means.detach().numpy()  # (3, N)
        self._points = forest.place.in_world(means[:, :: -(-means.shape[1] // _LANDMARKS)].T)
        self._kept: _Kept | None = None

    def forget(self) -> None:
        """Says that the forest looks different now."""
        self._kept = None

    def of(self, camera: Camera, nearly: bool = False) -> NDArray[np.float32]:
        """(rows + 1, columns + 1) saliency in 0..1 at the corners of the detail map's cells.

        Args:
            camera: the view.
            nearly: whether the saliency of an earlier view will do from which most of what it shows has moved
                by less than a cell.
        """
        kept = self._kept
        if kept is None or not (kept.camera == camera or (nearly and self._hardly_moved(kept, camera))):
            kept = self._kept = self._computed(camera)
        return kept.saliency

    def _computed(self, camera: Camera) -> _Kept:
        rate = max(0, round(np.log2(max(camera.width, camera.height) / _COARSE)))
        coarse = self._renderer.render_layer(camera, 1, rate).numpy()
        found = at_corners(saliency(coarse), camera.width, camera.height)
        pixels, depth = camera.project(self._points)
        inside = (pixels >= 0) & (pixels < (camera.width, camera.height))
        visible = (depth > 0) & inside.all(axis=1)
        return _Kept(camera, found, self._points[visible], pixels[visible])

    @staticmethod
    def _hardly_moved(kept: _Kept, camera: Camera) -> bool:
        if (kept.camera.width, kept.camera.height) != (camera.width, camera.height) or not len(kept.pixels):
            return False
        pixels, depth = camera.project(kept.landmarks)
        moved = np.linalg.norm(pixels - kept.pixels, axis=1)
        return float(np.mean((depth > 0) & (moved < CELL))) >= _SHARE
