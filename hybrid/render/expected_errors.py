"""Where in a view a forest is wrong, as far as it knows, and in which cells of a frame paths mend most."""

from __future__ import annotations

import logging
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS
from compose.eye.detail import CELL, resolved_share
from compose.fovea.cells import CellRegion, chosen
from compose.fovea.foveation import FoveaRegion
from compose.fusion.parents import TYPICAL_ERROR
from compose.image.colour import Image
from hybrid.render.forest_attachments import errors_of
from hybrid.render.frame_settings import FrameSettings
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.model.gaussians import SH_DC, perceptual_from_radiance

_LOG = logging.getLogger("hybrid")
# log2 of pixels per sample along each axis at which errors are drawn, and samples along the side of a cell.
_RATE = 3
_PER_CELL = CELL >> _RATE
# Errors are drawn as radiance, which has few digits where it is as small as they are.
_SCALE = 256.0
# The power with which errors grow with a frame's resolution over that of training: in frames of twice that,
# four scenes had 3 to 4 times the error.
_FINER = 1.75
# Errors below this are of no more use.
_LEAST = 1e-9


def harmonics_of(errors: torch.Tensor) -> torch.Tensor:
    """(1, 3, N) harmonics of nodes that show errors (N,) as their radiance."""
    return ((perceptual_from_radiance(_SCALE * errors) - 0.5) / SH_DC).expand(1, 3, -1).contiguous()


def errors_in(image: Image) -> NDArray[np.float32]:
    """(H, W) errors that an image (H, W, 3) of such nodes shows."""
    return image[..., 0] / _SCALE


class ExpectedErrors:
    """The squared errors of sRGB values that a forest expects of itself: radiance of its coarsest layer."""

    def __init__(self, arrays: Arrays, forest: Forest):
        self._arrays, self._forest, self._time = arrays, forest, 0.0
        self._kept: tuple[Camera, float, NDArray[np.float32]] | None = None

    @cached_property
    def _of_nodes(self) -> torch.Tensor | None:
        return errors_of(self._forest)

    @cached_property
    def are_known(self) -> bool:
        """Whether the forest has any; if not, that is logged."""
        if self._of_nodes is not None:
            return True
        _LOG.warning(
            "paths are traced in the disc: this forest does not say where it is wrong; it was imported, or "
            "made by an earlier version"
        )
        return False

    def typical_in(self, camera: Camera) -> float:
        """The error that is typical of a camera's frames; TYPICAL_ERROR if none are known.

        It is that of the nodes, but more where frames are finer than those of the training.
        """
        if self._typical is None:
            return TYPICAL_ERROR
        return self._typical * max(camera.fy / self._forest.trained_focal, 1.0) ** _FINER

    @cached_property
    def _typical(self) -> float | None:
        """The geometric mean over the nodes; None if none are known."""
        errors = self._of_nodes
        if errors is None or not len(errors):
            return None
        return float(torch.log(errors.clamp(min=_LEAST)).mean().exp())

    @cached_property
    def _renderer(self) -> ForestRenderer:
        errors = self._of_nodes
        assert errors is not None, "errors are known"
        return ForestRenderer(self._arrays, self._forest.coarsest_alone(harmonics_of(errors)))

    def set_time(self, time: float) -> None:
        """Shows a time from 0 to 1 from now on."""
        self._time = time

    def of(self, camera: Camera) -> NDArray[np.float32]:
        """(rows, columns) mean squared error to expect in each cell of a camera's frame."""
        if self._kept is None or self._kept[:2] != (camera, self._time):
            self._renderer.set_time(self._time)
            drawn = errors_in(self._renderer.render_layer(camera, 1, _RATE).numpy())
            down, across = (-size % _PER_CELL for size in drawn.shape)
            drawn = np.pad(drawn, ((0, down), (0, across)), mode="edge")
            cells = drawn.reshape(len(drawn) // _PER_CELL, _PER_CELL, -1, _PER_CELL).mean(axis=(1, 3))
            self._kept = camera, self._time, cells
        return self._kept[2]

    def region(self, camera: Camera, settings: FrameSettings) -> FoveaRegion | CellRegion:
        """The cells in which paths mend what a viewer sees most, for as many paths as the disc would take."""
        disc = settings.foveation.region(camera.width, camera.height)
        if disc.covers_frame:
            return disc
        worth = self.of(camera)
        if settings.acuity_model != "none":
            model = ACUITY_MODELS[settings.acuity_model]
            size = camera.width, camera.height
            worth = worth * resolved_share(settings.display, settings.gaze, *size, model)
        pixels = disc.count * settings.spp / settings.traced_spp
        count = max(round(pixels / CELL**2), min(disc.count, 1))
        return CellRegion(camera.width, camera.height, chosen(worth, count))
