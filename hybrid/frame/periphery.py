"""The splatted periphery of a frame: what the eye resolves where, and the pictures that this asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS, DEFAULT_ACUITY_MODEL, acuity_model_named
from compose.eye.detail import CELL, COARSEST_RATE, DetailMap, at_corners, detail_map
from compose.eye.display import DISPLAYS, Display
from compose.eye.gaze import Gaze
from compose.eye.saliency import saliency
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image
from splat.base.arrays import Arrays
from splat.lod.joining import Picture
from splat.lod.pictures import ForestRenderer, JoinedFrame, KeptPictures, finest_frequency
from splat.model.forest import Forest
from splat.raster.binning import TILE

# Side, in pixels, of the coarse picture in which attention is looked for.
_COARSE = 64
# The lattice's cells are the rasterizer's tiles: what is wanted of the one is drawn by the other.
assert CELL == TILE


@dataclass(frozen=True)
class Viewing:
    """Who looks, and with what eyes.

    Attributes:
        display: the frame is shown around its centre.
        acuity model: name of the acuity model from eccentricity to cut-off.
        layers: coarsest and finest layer that may be drawn, (1, L); None for all.
        rate: finest rate of the periphery, log2 of pixels per sample along each axis.

    Raises:
        UserError: there is no such acuity model.
    """

    display: Display = DISPLAYS["desktop"]
    acuity_model: str = DEFAULT_ACUITY_MODEL
    layers: tuple[int, int] | None = None
    rate: int = 0

    def __post_init__(self) -> None:
        acuity_model_named(self.acuity_model)


class Periphery:
    """Draws the periphery of frames with one forest for one viewer.

    Args:
        arrays: the rasterizer's array types.
        forest: what to draw.
        viewing: for whom.

    Raises:
        UserError: the forest does not have those layers.
    """

    def __init__(self, arrays: Arrays, forest: Forest, viewing: Viewing):
        self.forest = forest
        self.view_as(viewing)
        self._renderer = ForestRenderer(arrays, forest)
        self._attention: tuple[bytes, NDArray[np.float32]] | None = None
        # Pictures of the last view that stood still, and of which view and viewer they are.
        self._kept: tuple[tuple[object, ...], KeptPictures, Image] | None = None

    def view_as(self, viewing: Viewing) -> None:
        """From now on for another viewer.

        Raises:
            UserError: the forest does not have those layers.
        """
        count = len(self.forest.counts)
        low, high = viewing.layers or (1, count)
        if not 1 <= low <= high <= count:
            raise UserError(f"--layers {low} {high}: this forest has layers 1 to {count}")
        self.viewing, self._low, self._high = viewing, low, high

    def detail(self, camera: Camera, gaze: Gaze, fov_b: float) -> DetailMap:
        """The detail that the viewer resolves in a frame."""
        limited = self.viewing.acuity_model != "none"
        return detail_map(
            self.viewing.display,
            gaze,
            camera.width,
            camera.height,
            ACUITY_MODELS[self.viewing.acuity_model],
            fov_b,
            finest_frequency(camera, self.forest, self._high),
            tuple(
                max(self._finest_rate(camera, n) if limited else 0, self.viewing.rate)
                for n in range(1, self._high + 1)
            ),
            self._low,
            self.saliency(camera) if limited else None,
        )

    def _finest_rate(self, camera: Camera, layer: int) -> int:
        """A layer has nothing to show between the pixels that it was trained on."""
        pixel = camera.fy / self.forest.focal_of(layer)
        samples = 1 if ACUITY_MODELS[self.viewing.acuity_model].relative else 2
        return int(np.clip(np.floor(np.log2(pixel / samples)), 0, COARSEST_RATE))

    def saliency(self, camera: Camera) -> NDArray[np.float32]:
        """In 0..1 at the corners of the cells: where layer 1, drawn coarsely, draws attention.

        Kept until the camera moves.
        """
        if self._attention is None or self._attention[0] != camera.key:
            rate = max(0, round(np.log2(max(camera.width, camera.height) / _COARSE)))
            found = saliency(self._renderer.render_layer(camera, 1, rate).image())
            self._attention = (camera.key, at_corners(found, camera.width, camera.height))
        return self._attention[1]

    def draw(self, camera: Camera, detail: DetailMap, region: FoveaRegion) -> JoinedFrame:
        """What of a frame the fovea does not hide, at the detail that is needed."""
        pictures = [
            Picture(step.layer, step.rate, detail.share(number)) for number, step in enumerate(detail.steps)
        ]
        return self._renderer.render(camera, pictures, detail.cutoff, region.peripheral_tiles(TILE))

    def draw_still(self, camera: Camera, detail: DetailMap, region: FoveaRegion) -> JoinedFrame:
        """As `draw`, from pictures that are drawn once for a camera and joined anew for each gaze.

        All layers and rates that any gaze may ask for are drawn over the whole frame: not much more than one
        frame takes otherwise, and joining takes a quarter of it. Only the cut-off is not that of the gaze
        within a step: a little more detail is there than it asks for.
        """
        shares = [detail.share(number) for number in range(len(detail.steps))]
        return self._pictures(camera, detail)[0].joined(shares, region.peripheral_tiles(TILE))

    def whole_still(self, camera: Camera, detail: DetailMap) -> Image:
        """As `whole`, drawn once for a camera."""
        return self._pictures(camera, detail)[1]

    def _pictures(self, camera: Camera, detail: DetailMap) -> tuple[KeptPictures, Image]:
        of = camera.key, self.viewing, detail.steps
        if self._kept is None or self._kept[0] != of:
            steps = [(step.layer, step.rate) for step in detail.steps]
            self._kept = of, KeptPictures(self._renderer, camera, steps), np.array(self.whole(camera))
        return self._kept[1:]

    def under_fovea(self, camera: Camera, region: FoveaRegion) -> JoinedFrame:
        """The finest layer that may be drawn at full rate, over the rectangle around the disc."""
        wanted = region.foveal_tiles(TILE)
        corners = (wanted.shape[0] + 1, wanted.shape[1] + 1)
        picture = Picture(self._high, 0, np.ones(corners, dtype=np.float32))
        return self._renderer.render(camera, [picture], np.full(corners, 0.5, dtype=np.float32), wanted)

    def enlargement(self, camera: Camera) -> float:
        """Side of the pixels that the finest layer was trained on, in pixels of a camera."""
        return camera.fy / self.forest.focal_of(self._high)

    def whole(self, camera: Camera) -> Image:
        """(H, W, 3) the finest layer that may be drawn, over the whole frame at full rate."""
        return self._renderer.render_layer(camera, self._high).image()
