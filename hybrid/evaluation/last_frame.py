"""Frames whose Gaussians are selected by where they were in the frame before: Fov-GS's baseline.

Selecting by where they are now requires them to be deformed first. The rows above the last two of Fov-GS's
Table 3 avoid that with the positions of the last frame; what has moved since is missing where it is now, or
drawn where its layer does not count. Here it is for comparison only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.image.colour import Image
from hybrid.base.compute_device import device_arrays
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.periphery import Periphery
from hybrid.render.splat_renderer import SplatRenderer
from splat.lod.layer_images import at_corners
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.raster.tiles import TILE

# Standard deviations to which a node reaches.
_REACH = 3.0
# Opacity before the sigmoid of nodes that are not selected: alpha is below 1/255.
_HIDDEN = -20.0


class LastFrameRenderer:
    """Renders frames of a forest with layers, each with the nodes that the frame before has selected."""

    def __init__(self, forest: Forest):
        self._forest, self._periphery = forest, Periphery(device_arrays(), forest)
        self._ready = SplatRenderer(forest)
        self._before: FrameSettings | None = None

    def forget(self) -> None:
        """The next frame selects by itself."""
        self._before = None

    def select(self, settings: FrameSettings) -> None:
        """Selects what the next frame is rendered with; `settings` have its camera."""
        selected = self.selected(self._before or settings)
        self._before = settings
        nodes = self._forest.nodes
        logits = torch.where(torch.from_numpy(selected), nodes.gaussians.opacity_logits, _HIDDEN)
        gaussians = replace(nodes.gaussians, opacity_logits=logits)
        self._ready = SplatRenderer(replace(self._forest, nodes=replace(nodes, gaussians=gaussians)))

    def frame(self, settings: FrameSettings) -> Image:
        """(H, W, 3) the next frame, once its nodes are selected."""
        return self._ready.frame(settings).composite

    def selected(self, settings: FrameSettings) -> NDArray[np.bool_]:
        """(N,) which nodes of all layers reach a cell for which their layer is drawn."""
        camera = settings.camera
        assert camera is not None
        self._periphery.set_time(settings.time)
        detail = self._periphery.detail(camera, settings)
        forest, nodes = self._forest, self._forest.nodes
        shown = nodes.gaussians
        if forest.motion is not None:
            with torch.no_grad():
                shown = forest.motion.shown(shown, nodes.semantic, settings.time)
        boxes = np.split(_boxes(shown, forest.place.camera(camera)), np.cumsum(forest.counts)[:-1])
        of_layers = enumerate(boxes, start=1)
        return np.concatenate([_touches(own, _cells(detail, layer)) for layer, own in of_layers])


def _cells(detail: DetailMap, layer: int) -> NDArray[np.bool_]:
    """(rows, columns) the cells of TILE pixels in which a layer is drawn."""
    drawn = np.zeros(tuple(side - 1 for side in detail.step_index.shape), dtype=bool)
    for number, step in enumerate(detail.steps):
        if step.layer == layer:
            drawn |= np.any([corner > 0 for corner in at_corners(detail.weight(number))], axis=0)
    return drawn


def _boxes(gaussians: Gaussians, camera: Camera) -> NDArray[np.float64]:
    """(N, 4) left, top, right and bottom pixel that nodes reach; empty for those behind the camera."""
    with np.errstate(divide="ignore", invalid="ignore"):
        position, depth = camera.project(gaussians.means.T.double().numpy())
        largest = gaussians.log_scales.max(dim=0).values.double().exp().numpy()
        reach = (_REACH * largest * camera.fy / depth)[:, None]
        boxes = np.hstack([position - reach, position + reach])
    boxes[~(depth > 0)] = [0, 0, -1, -1]
    return boxes


def _touches(boxes: NDArray[np.float64], cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) which boxes touch any of the cells."""
    sums = np.pad(cells.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    size = [cells.shape[1], cells.shape[0]]
    left, top = np.clip(np.floor(boxes[:, :2] / TILE), 0, size).astype(np.int64).T
    right, bottom = np.clip(np.floor(boxes[:, 2:] / TILE) + 1, 0, size).astype(np.int64).T
    inside = (left < right) & (top < bottom)
    count = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return inside & (count > 0)
