"""The splatted periphery of a frame: the detail that eye and image ask for, and the layers drawn for it."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.acuity import ACUITY_MODELS, COARSEST_RATE
from compose.eye.detail import CELL, DetailMap, Lattice, LayerRange, at_corners, detail_map, saliency
from compose.fovea.cells import CellRegion
from compose.fovea.foveation import FoveaRegion
from hybrid.render.frame_settings import FrameSettings
from hybrid.render.level_quality import LevelQuality, quality_of, weights_at
from splat.lod.forest_renderer import CachedLayerImages, ForestRenderer, finest_frequency
from splat.lod.layer_images import CONTINUOUS, LayerImage, SplatImage, Under, touched_corners
from splat.model.forest import Forest
from splat.model.points import Bits
from splat.raster.cut import greatest_factor
from splat.raster.tiles import TILE

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# Side in pixels of the coarse image in which saliency is computed.
_COARSE = 64
# Number of Gaussians by whose motion views are compared, at most, and the share of them that counts.
_LANDMARKS = 512
_SHARE = 0.9
# Cycles per pixel: where less is resolved, levels are as high as where this is.
_COARSEST_CUTOFF = 1 / 256
# Pixels: a continuous level of detail at which only the smallest Gaussians are drawn.
_FINEST_LEVEL = 1e-4
# In the finest details that are resolved: levels from which those of a quality rise.
_LEAST_LEVEL = 0.1


class _Kept(NamedTuple):
    """Saliency (rows + 1, columns + 1) of a view, and points (K, 3) that are visible at pixels (K, 2)."""

    camera: Camera
    saliency: NDArray[np.float32]
    landmarks: NDArray[np.float64]
    pixels: NDArray[np.float64]


class ViewSaliency:
    """Computes the saliency of views from a forest's coarsest layer."""

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

        If `nearly`, that of an earlier view will do from which most of what it shows has moved by less than a
        cell.
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


def continuous_levels(level: float, cutoff: NDArray[np.float32]) -> NDArray[np.float32]:
    """Standard deviations in pixels that Gaussians may have where frequencies up to a cut-off are resolved.

    Args:
        level: in the finest details that are resolved.
        cutoff: in cycles per pixel.
    """
    # What is resolved, at most half a cycle per pixel, takes two samples per cycle.
    return np.float32(level * 0.5) / np.maximum(cutoff, np.float32(_COARSEST_CUTOFF))


# The detail map's cells are the rasterizer's tiles.
assert CELL == TILE


class Periphery:
    """Draws the periphery of frames with one forest, and keeps what depends on the camera alone."""

    def __init__(self, arrays: Arrays, forest: Forest):
        self.forest, self._arrays = forest, arrays
        self._renderer = ForestRenderer(arrays, forest)
        # What nodes make visible, as it was learnt and on the device.
        self._visibility: tuple[torch.Tensor, Float] | None = None
        self._saliency = ViewSaliency(self._renderer, forest)
        # What the layers of the last still view were drawn for; their images; the finest one as a whole.
        self._kept: tuple[tuple[object, ...], CachedLayerImages, SplatImage] | None = None
        self._time = 0.0
        self._holds_cut = False

    def hold_cut(self, drawn: Bits) -> None:
        """Draws these nodes (N + M,) of the hierarchy wherever levels are continuous.

        What draws attention in the picture has no part in the detail then, as it had none in the cut.
        """
        self._holds_cut = True
        self._renderer.hold_cut(drawn)

    def set_time(self, time: float) -> None:
        """Shows the forest at a time from 0 to 1 in what is drawn from now on."""
        if time != self._time:
            self._time, self._kept = time, None
            self._renderer.set_time(time)
            self._saliency.forget()

    def layers_of(self, settings: FrameSettings) -> tuple[int, int]:
        """Coarsest and finest layer that may be drawn; UserError if the forest does not have those."""
        return settings.layers_of(len(self.forest.counts))

    def detail(self, camera: Camera, settings: FrameSettings, moving: bool = False) -> DetailMap:
        """The detail that the viewer resolves in each part of a frame.

        While the camera is moving, the saliency of an earlier view will do that shows nearly the same.
        UserError if the forest does not have the layers that the settings ask for.
        """
        low, high = self.layers_of(settings)
        if settings.is_continuous:
            low = high
        unlimited = settings.acuity_model == "none"
        rates = [0 if unlimited else self._finest_rate(camera, settings, n) for n in range(1, high + 1)]
        layers = LayerRange(
            finest_frequency(camera, self.forest, high),
            tuple(max(rate, settings.rate) for rate in rates),
            low,
        )
        detail = detail_map(
            settings.display,
            settings.gaze,
            camera.width,
            camera.height,
            ACUITY_MODELS[settings.acuity_model],
            settings.hidden_radius,
            layers,
            None if unlimited or self._holds_cut else self._saliency.of(camera, moving),
        )
        if not settings.is_continuous:
            return detail
        return replace(detail, levels=self._levels(camera, settings, detail))

    def _finest_rate(self, camera: Camera, settings: FrameSettings, layer: int) -> int:
        """Finest useful sampling rate of a layer: it has no detail between its training pixels."""
        pixel = camera.fy / self.forest.focal_of(layer)
        samples = 1 if ACUITY_MODELS[settings.acuity_model].relative else 2
        return int(np.clip(np.floor(np.log2(pixel / samples)), 0, COARSEST_RATE))

    def draw(self, camera: Camera, detail: DetailMap, region: FoveaRegion | CellRegion) -> SplatImage:
        """The part of a frame that the fovea leaves visible, drawn with the required detail."""
        return self.draw_with_disc(camera, None, detail, region)[0]

    def draw_with_disc(
        self,
        camera: Camera,
        settings: FrameSettings | None,
        detail: DetailMap,
        region: FoveaRegion | CellRegion,
    ) -> tuple[SplatImage, SplatImage]:
        """What `draw` and, with settings, `under_disc` draw, in little more time than `draw` takes."""
        levels = detail.levels
        images = [
            LayerImage(one.layer if levels is None else CONTINUOUS, one.rate, detail.weight(n))
            for n, one in enumerate(detail.steps)
        ]
        under = None if settings is None else self._under(settings, region)
        if levels is not None and under is not None:
            # Under the disc lies everything that there is.
            levels = levels.copy()
            levels[touched_corners(under.cells)] = _FINEST_LEVEL
        tiles = region.peripheral_tiles(TILE)
        return self._renderer.render(camera, images, detail.low_pass, tiles, under, levels)

    def _levels(self, camera: Camera, settings: FrameSettings, detail: DetailMap) -> Lattice:
        """(rows + 1, columns + 1) continuous levels of detail at the corners of cells, in pixels."""
        if settings.layers is not None:
            raise UserError(f"layers {settings.layers}: continuous levels of detail have none; leave out one")
        if self.forest.motion is not None or self.forest.light is not None:
            name = self.forest.scene_name
            raise UserError(f"level, gaussians, level_jod: something moves in the forest of {name}")
        usual = 1.0 if settings.level_jod is None else _LEAST_LEVEL
        levels, factor = continuous_levels(settings.level or usual, detail.cutoff), 1.0
        if settings.level_jod is not None:
            quality = self._quality_for(settings)
            sums = self.visible(camera, detail, levels, quality)
            factor = greatest_factor(sums, quality.most(settings.level_jod))
        if settings.gaussians is not None:
            factor = max(factor, self._renderer.least_factor(camera, levels, settings.gaussians))
        return levels * np.float32(factor)

    @cached_property
    def _quality(self) -> LevelQuality | None:
        return quality_of(self.forest)

    def _quality_for(self, settings: FrameSettings) -> LevelQuality:
        quality = self._quality
        if quality is None:
            raise UserError(
                f"level_jod: the forest of {self.forest.scene_name} does not know how good its levels look; "
                "run hybrid levels, with FovVideoVDP installed"
            )
        if quality.display != settings.display:
            raise UserError(
                f"level_jod: the levels were judged for {quality.display}; "
                f"run hybrid levels for {settings.display}"
            )
        return quality

    def visible(
        self, camera: Camera, detail: DetailMap, levels: Lattice, quality: LevelQuality
    ) -> NDArray[np.float64]:
        """What a viewer sees of continuous levels, per pixel, at each step of their factor."""
        if self._visibility is None or self._visibility[0] is not quality.visibility:
            values = np.append(np.zeros(len(self.forest.finest), np.float32), quality.visibility.numpy())
            self._visibility = quality.visibility, uploaded(self._arrays.plain.Float, values)
        weights = weights_at(detail.eccentricity)
        sums = self._renderer.differences(camera, levels, self._visibility[1], weights)
        return sums / (camera.width * camera.height)

    def draw_still(
        self, camera: Camera, settings: FrameSettings, detail: DetailMap, region: FoveaRegion | CellRegion
    ) -> tuple[SplatImage, SplatImage]:
        """Like `draw` and `whole`, from layers that are drawn once per camera and joined again for each gaze.

        All layers and rates that any gaze may require are drawn over the whole frame, which takes little
        longer than `draw` takes for one frame; joining takes a quarter of that. Within a step the cut-off
        does not follow the gaze, so the frame has slightly more detail than required.
        """
        steps = [(step.layer, step.rate) for step in detail.steps]
        drawn_for = camera, self.layers_of(settings), steps
        if self._kept is None or self._kept[0] != drawn_for:
            layers = CachedLayerImages(self._renderer, camera, steps)
            self._kept = drawn_for, layers, self.whole(camera, settings)
        _, layers, whole = self._kept
        shares = [detail.weight(number) for number in range(len(steps))]
        return layers.composite(shares, region.peripheral_tiles(TILE)), whole

    def under_disc(
        self, camera: Camera, settings: FrameSettings, region: FoveaRegion | CellRegion
    ) -> SplatImage:
        """The finest allowed layer at full rate, over the rectangle around the disc."""
        under = self._under(settings, region)
        nothing = np.zeros((under.cells.shape[0] + 1, under.cells.shape[1] + 1), np.float32)
        finest = np.full_like(nothing, _FINEST_LEVEL) if settings.is_continuous else None
        return self._renderer.render(camera, [], nothing, np.zeros_like(under.cells), under, finest)[1]

    def _under(self, settings: FrameSettings, region: FoveaRegion | CellRegion) -> Under:
        layer = CONTINUOUS if settings.is_continuous else self.layers_of(settings)[1]
        return Under(layer, region.foveal_tiles(TILE))

    def whole(self, camera: Camera, settings: FrameSettings) -> SplatImage:
        """The finest allowed layer over the whole frame at full rate."""
        return self._renderer.render_layer(camera, self.layers_of(settings)[1])
