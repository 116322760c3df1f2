"""Fills what a forest does not know: path-traced at low resolution, denoised, blended into the splats.

A forest knows what its training views saw from no much greater distance.

Radiance over albedo varies slowly: traced at a quarter of the resolution and multiplied by the albedo of each
pixel, it is as good as radiance traced at half of it, at a third of the time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, median_filter, minimum_filter

from compose.base.arrays import Arrays, constant, uploaded
from compose.camera.camera import Camera
from compose.camera.seen_surfaces import SeenSurfaces
from compose.fovea.disc import Disc, blend
from compose.image.device_image import DeviceImage
from hybrid.render.forest_attachments import views_of
from pathtrace.trace.film import FilmPositions, box_positions, interleaved, pixel_positions
from pathtrace.trace.first_hit import SKY_DISTANCE
from pathtrace.trace.traced_images import denoise
from pathtrace.trace.tracer import Tracer
from splat.lod.forest_renderer import ForestRenderer
from splat.model.forest import Forest
from splat.raster.tiles import TILE

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# Rows and columns of the depth map of a training view.
_MAP = 64
# Rays by which a view is tried, at most: where there are more tiles, a ray stands for several of them.
_MOST_RAYS = 2048
# Distance from which a few training views saw a point, over that from which it is seen now: up to the
# first, splats show it well; from the second on they are blurred and out of shape.
_NEAR, _FAR = 1.6, 2.4
# Cells beside what is not known that count as such.
_BORDER = 2
# Opacity of splats up to which a pixel counts as unknown, and from which on as known, where nothing is known
# of training views.
_EMPTY, _FULL = 0.5, 0.9
# log2 of a tile's side: sampling rate at which opacity is drawn.
_TILE_RATE = int(np.log2(TILE))


class KnownSurfaces:
    """Tells what a forest knows of its scene.

    It knows what its training views saw, where it says which they were, else what is opaque.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self._arrays, self._forest = arrays, forest
        self._views = views_of(forest)
        self._seen: SeenSurfaces | None = None

    def cell(self, camera: Camera) -> int:
        """Side in pixels of the cells in which a frame is tried."""
        side = TILE
        while math.prod(_grid(camera, side)) > _MOST_RAYS:
            side *= 2
        return side

    def of(self, camera: Camera, tracer: Tracer) -> NDArray[np.float32]:
        """(rows, columns) how well the splats show each cell of a frame, 0 where not at all to 1.

        Up to two cells beside one that is not known count as that one, since few views showed what is there,
        and Gaussians smear. A single cell that differs from those around it counts as these do.
        """
        side = self.cell(camera)
        points = _points(tracer, camera, side)
        known = self._of_points(points, camera, tracer) if self._views else self._opaque(camera, side)
        known = known.reshape(_grid(camera, side))
        if tracer.scene.mitsuba.environment() is None:
            # Beyond the scene is darkness, which splats show as well as paths do.
            beyond = np.abs(points - camera.position).max(axis=1) > SKY_DISTANCE / 4
            known[beyond.reshape(known.shape)] = 1
        plain = median_filter(known, 3, mode="nearest")
        return minimum_filter(plain, 2 * _BORDER + 1, mode="nearest")

    def _of_points(self, points: NDArray[np.float32], camera: Camera, tracer: Tracer) -> NDArray[np.float32]:
        """(N,) how well the training views saw points (N, 3) of a view."""
        if self._seen is None:
            depths = np.stack([_depths(tracer, view) for view in self._views])
            self._seen = SeenSurfaces(self._arrays, self._views, depths)
        pixel = self._seen.finest(points)
        depth = points @ camera.world_to_camera[2, :3].astype(np.float32) + np.float32(
            camera.world_to_camera[2, 3]
        )
        # Finer frames of the same place make nothing unknown that coarser ones show.
        focal = np.float32(min(view.fy for view in self._views))
        ratio = pixel * focal / np.maximum(depth, np.finfo(np.float32).tiny)
        return np.clip((_FAR - ratio) / (_FAR - _NEAR), 0, 1).astype(np.float32)

    def _opaque(self, camera: Camera, side: int) -> NDArray[np.float32]:
        """(rows, columns) the share of full opacity that the coarsest layer has in each cell."""
        image = self._coarse.render_layer(camera, 1, _TILE_RATE)
        if not image.nodes:
            return np.zeros(_grid(camera, side), dtype=np.float32)
        samples = image.values.numpy().reshape(-1, image.stride, image.channels)
        opacity = samples[: image.height : side // TILE, : image.width : side // TILE, -1]
        return np.clip((opacity - _EMPTY) / (_FULL - _EMPTY), 0, 1).astype(np.float32)

    @cached_property
    def _coarse(self) -> ForestRenderer:
        """Draws the coarsest layer alone."""
        return ForestRenderer(self._arrays, self._forest.coarsest_alone())


def _grid(camera: Camera, side: int) -> tuple[int, int]:
    """Rows and columns of cells of that side in pixels, which cover a frame."""
    return -(-camera.height // side), -(-camera.width // side)


def _points(tracer: Tracer, camera: Camera, side: int) -> NDArray[np.float32]:
    """(N, 3) apparent position of what a ray in each cell hits, row by row."""
    top, left = (np.arange(0, size, side, dtype=np.float32) for size in (camera.height, camera.width))
    tall, wide = (
        np.minimum(side, size - first) for first, size in ((top, camera.height), (left, camera.width))
    )
    grids = (np.meshgrid(a, b, indexing="ij") for a, b in ((top, left), (tall, wide)))
    (y, x), (height, width) = ([axis.ravel() for axis in grid] for grid in grids)
    found = tracer.auxiliary(camera, box_positions(x, y, width, height), 1, 0)
    return interleaved(found.position)


def _depths(tracer: Tracer, camera: Camera) -> NDArray[np.float32]:
    """(rows, columns) depth along the view axis of what the cells of a training view show."""
    rows, columns = (min(_MAP, side) for side in (camera.height, camera.width))
    tall, wide = camera.height / rows, camera.width / columns
    y, x = (axis.ravel() for axis in np.mgrid[0:rows, 0:columns])
    size = np.full(len(x), tall), np.full(len(x), wide)
    found = tracer.auxiliary(camera, box_positions(x * wide, y * tall, size[1], size[0]), 1, 0)
    points = interleaved(found.position)
    depth = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    return depth.astype(np.float32).reshape(rows, columns)


# Side in pixels of the frame of those in which light is traced.
_SIDE = 4
# Added to the albedo before radiance is divided by it, so that dark surfaces do not amplify noise.
_ALBEDO_OFFSET = 0.1
# Keeps its random numbers apart from those of the disc.
_STREAM = 0x3F110000


@dataclass(frozen=True)
class FillEffort:
    """How well a fill is traced: samples of light per 4 x 4 pixels, of albedo per pixel, and the denoiser."""

    light_spp: int
    albedo_spp: int
    quick: bool


# While the camera moves, and of a single frame.
MOVING, STILL = FillEffort(1, 1, True), FillEffort(4, 4, False)


@dataclass(frozen=True)
class Fill:
    """What is filled of a frame: D pixels with weights, and linear radiance, three Floats (D,)."""

    disc: Disc
    radiance: list[Float]

    @property
    def share(self) -> float:
        """Part of the frame that is filled, 0 to 1."""
        return float(dr.sum(self.disc.weights)[0]) / (self.disc.width * self.disc.height)

    def over(self, splats: DeviceImage) -> DeviceImage:
        """Splats, in their memory, with the filled radiance in place of what they do not know."""
        return blend(splats, self.radiance, self.disc)[0]


class Filler:
    """Finds out what a forest does not know of a view, and traces that."""

    def __init__(self, arrays: Arrays, forest: Forest):
        self._arrays = arrays
        self._coverage = KnownSurfaces(arrays, forest)
        # What the last camera's frame shows of what is known, and the fill of the last still one.
        self._known: tuple[Camera, NDArray[np.float32]] | None = None
        self._kept: tuple[tuple[Camera, object], Fill] | None = None

    def forget(self) -> None:
        """Drops what was traced."""
        self._kept = None

    def fill(
        self,
        camera: Camera,
        probe: Tracer,
        light: Callable[[], Tracer],
        effort: FillEffort,
        seed: int,
        key: object = None,
    ) -> Fill | None:
        """What is filled of a camera's frame; None if the forest knows all of it.

        The probe traces rays to surfaces; `light` makes what traces radiance, and is called only if some is
        needed. Unless the key is None, the fill is traced once until the camera or the key changes.
        """
        if key is not None and self._kept is not None and self._kept[0] == (camera, key):
            return self._kept[1]
        if self._known is None or self._known[0] != camera:
            self._known = camera, self._coverage.of(camera, probe)
        unknown = np.float32(1) - self._known[1]
        if not unknown.any():
            return None
        side = self._coverage.cell(camera)
        disc = _disc(self._arrays, camera, unknown, side)
        # What is beside them as well: it shines through the enlargement, and denoising looks at it.
        cells = maximum_filter(unknown, 3, mode="nearest") > 0
        traced, known = self._light(light(), camera, cells, effort, seed + _STREAM)
        albedo = probe.auxiliary(
            camera, pixel_positions(mi.UInt32(disc.pixels), camera.width), effort.albedo_spp, seed
        ).albedo
        fill = Fill(disc, self._lit(disc, albedo, traced, known))
        if key is not None:
            self._kept = (camera, key), fill
        return fill

    def _light(
        self, tracer: Tracer, camera: Camera, cells: NDArray[np.bool_], effort: FillEffort, seed: int
    ) -> tuple[mi.TensorXf, Disc]:
        """Denoised radiance over albedo in some cells, in pixels of 4 x 4 pixels of the frame.

        Of the cells in which a frame is tried, (rows, columns) says which. Returns a tensor (h, w, 3) of the
        rectangle around them, and the pixels in them.
        """
        known = _known(self._arrays, camera, cells, self._coverage.cell(camera) // _SIDE)
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

    def _lit(self, disc: Disc, albedo: list[mi.Float], light: mi.TensorXf, known: Disc) -> list[Float]:
        """Radiance of the D pixels with an albedo in a light that is linear between its pixels.

        Of the light the tensor (h, w, 3) has the rectangle around its known pixels; outside that, it is 0.
        """
        arrays, plain, pixel = self._arrays, self._arrays.plain, disc.pixels
        assert known.box is not None, "some light is known wherever something is filled"
        top, left = (arrays.constant(side.start) for side in known.box)
        height, width = (arrays.constant(side) for side in known.shape)
        rows, columns = (plain.Int(arrays.constant(side)) for side in (known.height, known.width))
        row, column = arrays.rows_columns(pixel, disc.width)
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
    columns, shares = arrays.constant(unknown.shape[1]), uploaded(plain.Float, unknown)
    pixel = dr.arange(plain.UInt, height * width)
    taps = []
    for at, count in zip(arrays.rows_columns(pixel, width), unknown.shape, strict=True):
        last = arrays.constant(count - 1)
        place = dr.clip((plain.Float(at) + 0.5) * (1 / side) - 0.5, 0, plain.Float(last))
        first = plain.UInt(place)
        taps.append((first, dr.minimum(first + 1, last), place - plain.Float(first)))
    (top, bottom, down), (left, right, along) = taps
    upper, lower = (
        dr.lerp(
            dr.gather(plain.Float, shares, line * columns + left),
            dr.gather(plain.Float, shares, line * columns + right),
            along,
        )
        for line in (top, bottom)
    )
    weights = dr.lerp(upper, lower, down)
    shown = weights > 0
    dr.eval(weights, shown)
    pixels = plain.UInt(dr.compress(shown))
    return Disc(arrays, width, height, pixels, dr.gather(plain.Float, weights, pixels), None)


def _known(arrays: Arrays, camera: Camera, cells: NDArray[np.bool_], times: int) -> Disc:
    """The light's pixels in some cells, of which each has `times` along a side."""
    plain, (height, width) = arrays.plain, _grid(camera, _SIDE)
    row, column = arrays.rows_columns(dr.arange(plain.UInt, height * width), width)
    cell = row // times * arrays.constant(cells.shape[1]) + column // times
    pixels = dr.compress(dr.gather(plain.Bool, uploaded(plain.Bool, cells), cell))
    # Denoising takes as long as the rectangle is large.
    rows, columns = (
        slice(int(at.min()) * times, min((int(at.max()) + 1) * times, end))
        for at, end in zip(np.nonzero(cells), (height, width), strict=True)
    )
    return Disc(arrays, width, height, pixels, dr.full(plain.Float, 1, dr.width(pixels)), (rows, columns))
