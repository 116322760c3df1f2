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

from compose.base.arrays import Arrays, constant, uploaded
from compose.blend.blend import blend
from compose.camera.camera import Camera
from compose.fovea.disc import Disc
from compose.image.device import DeviceImage
from hybrid.frame.coverage import Coverage
from pathtrace.base.denoise import denoise
from pathtrace.trace.film import FilmPositions, pixel_positions
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
        traced, known = _light(self._arrays, light(), camera, cells, side, effort, seed + _STREAM)
        albedo = probe.auxiliary(
            camera, pixel_positions(mi.UInt32(disc.pixels), camera.width), effort.albedo_spp, seed
        ).albedo
        return Fill(disc, self._lit(disc, albedo, traced, known))

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

    def _lit(self, disc: Disc, albedo: list[Any], light: Any, known: Disc) -> list[Any]:
        """Radiance of pixels with an albedo in a light that is linear between its pixels.

        Args:
            disc: the D pixels.
            albedo: three Floats (D,).
            light: (h, w, 3) tensor of the rectangle around the pixels of the light that are known.
            known: those; 0 outside their rectangle.
        """
        arrays, plain, pixel = self._arrays, self._arrays.plain, disc.pixels
        assert known.box is not None, "some light is known wherever something is filled"
        top, left = (arrays.constant(side.start) for side in known.box)
        height, width = (arrays.constant(side) for side in known.shape)
        rows, columns = (plain.Int(arrays.constant(side)) for side in (known.height, known.width))
        row = pixel // arrays.constant(disc.width)
        column = pixel - row * arrays.constant(disc.width)
        x, y = ((plain.Float(at) + 0.5) * (1 / _SIDE) - 0.5 for at in (column, row))
        first_x, first_y = plain.Int(dr.floor(x)), plain.Int(dr.floor(y))
        total = [plain.Float(0) for _ in range(3)]
        for k in range(4):
            i, j = first_y + k // 2, first_x + k % 2
            weight = (1 - dr.abs(y - plain.Float(i))) * (1 - dr.abs(x - plain.Float(j)))
            # What lies above or to the left of the rectangle wraps around to beyond it.
            i, j = plain.UInt(dr.clip(i, 0, rows - 1)) - top, plain.UInt(dr.clip(j, 0, columns - 1)) - left
            inside = (i < height) & (j < width)
            for c in range(3):
                tap = dr.gather(plain.Float, light.array, (i * width + j) * 3 + c, inside)
                total[c] = dr.fma(weight, tap, total[c])
        lit = [t * (plain.Float(a) + _ALBEDO_OFFSET) for t, a in zip(total, albedo, strict=True)]
        dr.eval(lit)
        return lit


def _disc(arrays: Arrays, camera: Camera, unknown: NDArray[np.float32], side: int) -> Disc:
    """The pixels with a share of what is unknown, given for cells; it is linear between their centres."""
    plain, height, width = arrays.plain, camera.height, camera.width
    across, columns = arrays.constant(width), arrays.constant(unknown.shape[1])
    shares = uploaded(plain.Float, unknown)
    pixel = dr.arange(plain.UInt, height * width)
    row = pixel // across
    taps = []
    for at, count in zip((row, pixel - row * across), unknown.shape, strict=True):
        last = arrays.constant(count - 1)
        place = dr.clip((plain.Float(at) + 0.5) * (1 / side) - 0.5, 0, plain.Float(last))
        first = plain.UInt(place)
        taps.append((first, dr.minimum(first + 1, last), place - plain.Float(first)))
    (top, bottom, down), (left, right, along) = taps
    lines = [
        dr.lerp(*(dr.gather(plain.Float, shares, line * columns + at) for at in (left, right)), along)
        for line in (top, bottom)
    ]
    weights = dr.lerp(*lines, down)
    shown = weights > 0
    dr.eval(weights, shown)
    pixels = dr.compress(shown)
    return Disc(arrays, width, height, pixels, dr.gather(plain.Float, weights, pixels), None)


def _light(
    arrays: Arrays,
    tracer: Tracer,
    camera: Camera,
    cells: NDArray[np.bool_],
    side: int,
    effort: Effort,
    seed: int,
) -> tuple[Any, Disc]:
    """Denoised radiance over albedo in some cells, in pixels of 4 x 4 pixels of the frame.

    Args:
        arrays: the backend's array types.
        tracer: of the radiance.
        camera: the view.
        cells: (rows, columns) bool.
        side: of a cell in pixels of the frame.
        effort: how well.
        seed: same seed, same light.

    Returns:
        (h, w, 3) tensor of the rectangle around the cells; and the pixels in these.
    """
    known = _known(arrays, camera, cells, side // _SIDE)
    corner = pixel_positions(mi.UInt32(known.pixels), known.width)
    x, y = corner.x * _SIDE, corner.y * _SIDE
    ends = constant(mi.Float, camera.width), constant(mi.Float, camera.height)
    wide, tall = (dr.minimum(_SIDE, end - start) for start, end in zip((x, y), ends, strict=True))
    dr.eval(x, y, wide, tall)
    positions = FilmPositions(x, y, wide, tall)
    traced, features = tracer.trace_with_features(camera, positions, effort.light_spp, seed)
    radiance, albedo, normal = (
        known.tensor(known.images([dr.detach(of, preserve_type=False) for of in channels], [0.0] * 3))
        for channels in (traced.radiance, features.albedo, features.normal)
    )
    dr.eval(radiance, albedo, normal)
    light = denoise(radiance, albedo, normal, effort.quick) / (albedo + _ALBEDO_OFFSET)
    dr.eval(light)
    return light, known


def _known(arrays: Arrays, camera: Camera, cells: NDArray[np.bool_], times: int) -> Disc:
    """The light's pixels in some cells, of which each has `times` along a side."""
    plain, (height, width) = arrays.plain, (-(-size // _SIDE) for size in (camera.height, camera.width))
    pixel, across = dr.arange(plain.UInt, height * width), arrays.constant(width)
    row = pixel // across
    cell = row // times * arrays.constant(cells.shape[1]) + (pixel - row * across) // times
    pixels = dr.compress(dr.gather(plain.Bool, uploaded(plain.Bool, cells), cell))
    # Denoising takes as long as the rectangle is large.
    rows, columns = (
        slice(int(at.min()) * times, min((int(at.max()) + 1) * times, end))
        for at, end in zip(np.nonzero(cells), (height, width), strict=True)
    )
    return Disc(arrays, width, height, pixels, dr.full(plain.Float, 1, dr.width(pixels)), (rows, columns))
