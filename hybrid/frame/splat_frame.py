"""Frames of a forest alone, with the detail that the viewer resolves: all there is without a scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.detail import DetailMap
from compose.eye.gaze import eccentricity
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image
from hybrid.frame.periphery import Periphery
from hybrid.frame.settings import FrameSettings
from hybrid.output.images import save_frame
from hybrid.runtime.clock import Clock
from hybrid.runtime.device import device_arrays
from splat.model.forest import Forest


@dataclass(frozen=True)
class SplatFrame:
    """A frame of splats alone.

    Attributes:
        image: (H, W, 3) linear radiance.
        settings: how it was made.
        camera: the view.
        detail: the detail that the viewer resolves in each part of the frame.
        region: the disc that is traced, which has no pixel.
        nodes_drawn: Gaussians drawn, counted once per layer image.
        milliseconds: per pass (detail, splat), and in total.
        source: renders a further AOV when the frame is saved.
    """

    image: Image
    settings: FrameSettings
    camera: Camera
    detail: DetailMap
    region: FoveaRegion
    nodes_drawn: int
    milliseconds: dict[str, float]
    source: SplatRenderer = field(repr=False, compare=False)

    def aovs(self) -> dict[str, NDArray[np.float32]]:
        """The images that the frame consists of, by name: the layers of its EXR file.

        The frame itself has no name. splat is (H, W, 3) the finest layer over the whole frame, rendered now;
        eccentricity is in degrees on the display, level from 1 to L, rate log2 of pixels per sample.
        """
        viewer = self.settings.display.viewer(self.camera.width, self.camera.height)
        return {
            "": self.image,
            "splat": self.source.splats(self.settings),
            "eccentricity": eccentricity(viewer, self.settings.gaze),
            "level": self.detail.per_pixel(self.detail.drawn_level),
            "rate": self.detail.per_pixel(self.detail.drawn_rate),
        }

    def save(self, path: Path | str) -> None:
        """Writes the frame: .exr with all AOVs in linear radiance, or .png in sRGB.

        Raises:
            UserError: the file has another extension, or cannot be written.
        """
        save_frame(path, self.image, self.aovs)


class SplatRenderer:
    """Renders frames of a forest without its scene.

    Args:
        forest: what to draw.

    Example:
        >>> frames = hybrid.load_frames("lego")
        >>> renderer = hybrid.SplatRenderer(hybrid.load_forest("lego.forest"))
        >>> view = frames.held_out[0]
        >>> renderer.frame(hybrid.FrameSettings(camera=view.camera, time=view.time)).save("0.png")
    """

    def __init__(self, forest: Forest):
        self.forest = forest
        self._periphery = Periphery(device_arrays(), forest)

    def frame(self, settings: FrameSettings) -> SplatFrame:
        """Renders one frame.

        Args:
            settings: gaze, display, acuity model, layers, rate, scale and time; those of a disc are ignored.

        Raises:
            UserError: the settings have no camera, or ask for layers that the forest does not have.
        """
        camera, settings = _resolved(settings)
        clock = Clock()
        self._periphery.set_time(settings.time)
        detail = self._periphery.detail(camera, settings)
        clock.lap("detail")
        region = settings.foveation.region(camera.width, camera.height)
        drawn = self._periphery.draw(camera, detail, region)
        image = drawn.image()
        clock.lap("splat")
        parts = detail, region, drawn.nodes, clock.milliseconds()
        return SplatFrame(image, settings, camera, *parts, self)

    def splats(self, settings: FrameSettings) -> Image:
        """(H, W, 3) the finest allowed layer over the whole frame at full rate.

        Raises:
            UserError: as of `frame`.
        """
        camera, settings = _resolved(settings)
        self._periphery.set_time(settings.time)
        return self._periphery.whole(camera, settings).image()


def _resolved(settings: FrameSettings) -> tuple[Camera, FrameSettings]:
    """The camera, and the settings without a disc."""
    if settings.camera is None:
        raise UserError("camera: a forest alone has none; give one in the settings")
    return replace(settings, fov_a=0.0, fov_b=0.0).resolved(settings.camera)
