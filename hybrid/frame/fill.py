"""Fills what a forest does not know: path-traced at low resolution, denoised, blended into the splats.

Radiance over albedo varies slowly: traced at a quarter of the resolution and multiplied by the albedo of each
pixel, it is as good as radiance traced at half of it, at a third of the time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from compose.base.arrays import Arrays, uploaded
from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.fovea.disc import Disc
from compose.image.colour import Image
from compose.image.device import DeviceImage
from hybrid.frame.coverage import Coverage
from pathtrace.base.denoise import denoise
from pathtrace.trace.film import box_positions, interleaved, pixel_positions
from pathtrace.trace.tracer import Tracer
from splat.model.forest import Forest

# Side in pixels of the frame of those in which light is traced.
_SIDE = 4
# Added to the albedo before radiance is divided by it, so that dark surfaces do not amplify noise.
_ALBEDO_OFFSET = 0.1
# Keeps its random numbers apart from those of the disc.
_STREAM = 0x3F110000


@dataclass(frozen=True)
class Effort:
    """How well a fill is traced.

    Attributes:
        light_spp: samples per pixel of 4 x 4 pixels of the frame.
        albedo_spp: samples per pixel of the frame of what is seen there.
        quick: whether the quicker denoiser is used.
    """

    light_spp: int
    albedo_spp: int
    quick: bool


# While the camera moves, and of a single frame.
MOVING, STILL = Effort(1, 1, True), Effort(4, 4, False)


@dataclass(frozen=True)
class Fill:
    """What is filled of a frame.

    Attributes:
        disc: the D pixels, and the weight of the filled radiance in each.
        radiance: three Floats (D,), linear.
    """

    disc: Disc
    radiance: list[Any]

    @property
    def share(self) -> float:
        """Part of the frame that is filled, 0 to 1."""
        return float(dr.sum(self.disc.weights)[0]) / (self.disc.width * self.disc.height)

    def over(self, splats: DeviceImage) -> DeviceImage:
        """Splats with the filled radiance in place of what they do not know."""
        return blend(splats, self.radiance, self.disc)


class Filler:
    """Finds out what a forest does not know of a view, and traces that.

    Args:
        arrays: the backend's array types.
        forest: the forest.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self._arrays = arrays
        self._coverage = Coverage(arrays, forest)
        # What the last camera's frame shows of what is known, and the fill of the last still one.
        self._known: tuple[Camera, NDArray[np.float32]] | None = None
        self._kept: tuple[tuple[Camera, object], Fill] | None = None

    def forget(self) -> None:
        """Drops what was traced."""
        self._kept = None

    def fill(
        self, camera: Camera, probe: Tracer, light: Callable[[], Tracer], effort: Effort, seed: int
    ) -> Fill | None:
        """What is filled of a camera's frame; None if the forest knows all of it.

        Args:
            camera: the view.
            probe: traces rays to surfaces.
            light: makes what traces radiance; called only if some is needed.
            effort: how well.
            seed: same seed, same fill.
        """
        if self._known is None or self._known[0] != camera:
            self._known = camera, self._coverage.of(camera, probe)
        unknown = np.float32(1) - self._known[1]
        if not unknown.any():
            return None
        side = self._coverage.cell(camera)
        disc = _disc(self._arrays, camera, unknown, side)
        # What is beside them as well: it shines through the enlargement, and denoising looks at it.
        cells = maximum_filter(unknown, 3, mode="nearest") > 0
        traced = _light(light(), camera, cells, side, effort, seed + _STREAM)
        albedo = probe.auxiliary(
            camera, pixel_positions(mi.UInt32(disc.pixels), camera.width), effort.albedo_spp, seed
        ).albedo
        return Fill(disc, self._lit(disc, albedo, traced))

    def kept(
        self, camera: Camera, probe: Tracer, light: Callable[[], Tracer], key: object, seed: int
    ) -> Fill | None:
        """As `fill` with the effort of a still camera, traced once until the camera or the key changes."""
        if self._kept is None or self._kept[0] != (camera, key):
            made = self.fill(camera, probe, light, STILL, seed)
            if made is None:
                return None
            self._kept = (camera, key), made
        return self._kept[1]

    def _lit(self, disc: Disc, albedo: list[Any], light: Image) -> list[Any]:
        """Radiance of pixels with an albedo in a light (h, w, 3) that is linear between its pixels."""
        plain = self._arrays.plain
        rows, columns = (self._arrays.constant(side) for side in light.shape[:2])
        values, pixel = uploaded(plain.Float, light), disc.pixels
        row = pixel // self._arrays.constant(disc.width)
        column = pixel - row * self._arrays.constant(disc.width)
        x, y = ((plain.Float(at) + 0.5) * (1 / _SIDE) - 0.5 for at in (column, row))
        left, top = plain.Int(dr.floor(x)), plain.Int(dr.floor(y))
        total = [plain.Float(0) for _ in range(3)]
        for k in range(4):
            i, j = top + k // 2, left + k % 2
            weight = (1 - dr.abs(y - plain.Float(i))) * (1 - dr.abs(x - plain.Float(j)))
            i = plain.UInt(dr.clip(i, 0, plain.Int(rows) - 1))
            j = plain.UInt(dr.clip(j, 0, plain.Int(columns) - 1))
            for c in range(3):
                tap = dr.gather(plain.Float, values, (i * columns + j) * 3 + c)
                total[c] = dr.fma(weight, tap, total[c])
        lit = [t * (plain.Float(a) + _ALBEDO_OFFSET) for t, a in zip(total, albedo, strict=True)]
        dr.eval(lit)
        return lit


def _disc(arrays: Arrays, camera: Camera, unknown: NDArray[np.float32], side: int) -> Disc:
    """The pixels with a share of what is unknown, given for cells; it is linear between their centres."""
    height, width = camera.height, camera.width
    axes = []
    for size, count in zip((height, width), unknown.shape, strict=True):
        at = np.clip((np.arange(size) + 0.5) / side - 0.5, 0, count - 1)
        first = np.minimum(at.astype(np.int64), max(count - 2, 0))
        axes.append((first, np.minimum(first + 1, count - 1), (at - first).astype(np.float32)))
    (top, bottom, down), (left, right, across) = axes
    rows = unknown[top] + (unknown[bottom] - unknown[top]) * down[:, None]
    weights = (rows[:, left] + (rows[:, right] - rows[:, left]) * across).ravel()
    pixels = np.flatnonzero(weights > 0).astype(np.uint32)
    return Disc.of(arrays, width, height, pixels, weights[pixels])


def _light(
    tracer: Tracer, camera: Camera, cells: NDArray[np.bool_], side: int, effort: Effort, seed: int
) -> Image:
    """(h, w, 3) denoised radiance over albedo in pixels of 4 x 4 pixels of the frame; 0 outside the cells."""
    height, width = (-(-size // _SIDE) for size in (camera.height, camera.width))
    times = side // _SIDE
    wanted = cells.repeat(times, axis=0).repeat(times, axis=1)[:height, :width]
    rows, columns = np.nonzero(wanted)
    x, y = columns * _SIDE, rows * _SIDE
    sizes = (np.minimum(_SIDE, end - at) for end, at in ((camera.width, x), (camera.height, y)))
    traced, features = tracer.trace_with_features(camera, box_positions(x, y, *sizes), effort.light_spp, seed)
    # Denoising takes as long as the rectangle is large.
    box = tuple(slice(int(at.min()), int(at.max()) + 1) for at in (rows, columns))
    radiance, albedo, normal = (
        _image(channels, (height, width), (rows, columns))[box]
        for channels in (traced.radiance, features.albedo, features.normal)
    )
    light = np.zeros((height, width, 3), dtype=np.float32)
    light[box] = denoise(radiance, albedo, normal, effort.quick) / (albedo + _ALBEDO_OFFSET)
    return light


def _image(
    channels: list[Any], shape: tuple[int, int], pixels: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> Image:
    """(*shape, 3) image of three (N,) channels at N pixels, 0 elsewhere."""
    image = np.zeros((*shape, 3), dtype=np.float32)
    image[pixels] = interleaved(channels)
    return image
