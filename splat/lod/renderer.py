"""Renders several layers of a forest, each at its own sampling rate, and composites them into one frame.

A layer is drawn where it has a weight in the frame, at the sampling rate that is needed there, and the layer
images are composited by their weights, pixel by pixel. Fov-GS instead blends the Gaussians of two layers in
one list, each with a part of its opacity, which lets the coarse ones hide the fine ones: half-way between two
layers that costs 2.7 dB on `room` (29.2 against 31.8 dB at 256 x 256).

All layer images share one projection, one sort and one rasterization: they lie one above the other in an
atlas. An image at rate r has one sample per 2^r x 2^r pixels, at their centre.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.lod.compositing import composite
from splat.lod.footprints import ForestFootprints
from splat.lod.image import SplatImage, black_image
from splat.lod.layer_images import AtlasEntry, Lattice, LayerImage, Mask, at_corners, pack_atlas
from splat.lod.selection import touching
from splat.model.forest import Forest
from splat.raster.binning import Candidates, TileBounds
from splat.raster.blocks import CHANNELS
from splat.raster.parts import Parts, rasterize_parts
from splat.raster.projection import PIXEL_FILTER, Splats, filtered
from splat.raster.records import RecordLayout
from splat.raster.tiles import TILE, TileGrid

# Side of a tile in samples, where samples are larger than pixels: few splats cover many of those.
_COARSE_TILE = 8
# Share of the wanted cells from which the cells of a single image are drawn where they belong.
_WORTHWHILE = 0.1
# Filters of this width, as a multiple of the filter at the pixel grid, leave nothing but the faintest haze.
_WIDEST_BLUR = 1e9
# What splats need to know of their atlas entry: samples per pixel, minimum width of the filter as a multiple
# of the filter at the pixel grid, first row of samples, and bounds in tiles. Two floats are spare.
_ENTRY = RecordLayout((8,), scale=1, least_blur=1, offset=1, columns=1, top=1, bottom=1)


class ForestRenderer:
    """Renders a forest that stays on the device.

    Args:
        arrays: the backend's array types.
        forest: what to draw.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays, self.forest = arrays, forest
        self._footprints = ForestFootprints(arrays, forest)

    def set_time(self, time: float) -> None:
        """Shows the forest at a time from 0 to 1; forests in which nothing moves look alike at all times."""
        self._footprints.set_time(time)

    def render(
        self, camera: Camera, images: Sequence[LayerImage], cutoff: Lattice, wanted: NDArray[np.bool_]
    ) -> SplatImage:
        """Renders layer images and composites them.

        Args:
            camera: the view.
            images: layers and rates; their weights sum to 1 wherever a cell is wanted.
            cutoff: (rows + 1, columns + 1) highest frequency to keep, in cycles per pixel, at the corners of
                cells of TILE pixels; 0 or more.
            wanted: (rows, columns) bool, cells that are drawn at all.

        Raises:
            ValueError: the forest has no such layer, or a cut-off is negative or not a number.
        """
        images = [image for image in images if bool((image.weight > 0).any())]
        own, alone = _largest_alone(images, wanted)
        frame = self._composited(camera, images, cutoff, wanted & ~alone, alone)
        if own is None:
            return frame
        return self.draw_atlas(camera, pack_atlas([own], alone, TILE), cutoff, TILE, frame)

    def _composited(
        self, camera: Camera, images: Sequence[LayerImage], cutoff: Lattice, wanted: Mask, left_out: Mask
    ) -> SplatImage:
        """The cells in which images are drawn at a lower rate or mixed; black elsewhere."""
        tile = tile_side(image.rate for image in images)
        entries = pack_atlas(images, wanted, tile)
        atlas = self.draw_atlas(camera, entries, cutoff, tile)
        if not atlas.nodes:
            return atlas
        return composite(self.arrays, entries, atlas, camera, left_out if left_out.any() else None)

    def render_layer(self, camera: Camera, layer: int, rate: int = 0) -> SplatImage:
        """Renders one layer over the whole frame: its samples, (H / 2^rate, W / 2^rate) rounded up.

        Raises:
            ValueError: the forest has no such layer.
        """
        grid = TileGrid(camera.width, camera.height)
        corners = (grid.rows + 1, grid.columns + 1)
        image = LayerImage(layer, rate, np.ones(corners, np.float32))
        tile = tile_side([rate])
        entries = pack_atlas([image], grid.mask(None), tile)
        samples = self.draw_atlas(camera, entries, np.full(corners, 0.5, np.float32), tile)
        return replace(samples, width=-(-camera.width >> rate), height=-(-camera.height >> rate))

    def draw_atlas(
        self,
        camera: Camera,
        entries: Sequence[AtlasEntry],
        cutoff: Lattice,
        tile: int,
        frame: SplatImage | None = None,
    ) -> SplatImage:
        """Renders the atlas; a black image of the frame's size if no node shows in any entry.

        Args:
            camera: the view.
            entries: of the atlas.
            cutoff: as in `render`.
            tile: side of the rasterizer's tiles, in samples.
            frame: what a single entry at full rate is drawn into, instead of an atlas of its own; used up.
        """
        self._check(entries, cutoff)
        # A cut-off of 0 is that of the widest filter.
        cutoff = np.maximum(cutoff, 0.5 / _WIDEST_BLUR, dtype=np.float32)
        chosen = self._chosen(camera, entries, cutoff)
        if not any(dr.width(index) for index in chosen):
            return frame or black_image(self.arrays, camera, 0)
        splats, bounds = self._splats(camera, entries, chosen, cutoff, tile)
        columns = max(entry.tiles.shape[1] for entry in entries)
        wider = [np.pad(entry.tiles, ((0, 0), (0, columns - entry.tiles.shape[1]))) for entry in entries]
        mask = np.vstack(wider)
        grid = TileGrid(columns * tile, mask.shape[0] * tile, tile)
        parts = Parts(Candidates(self.arrays, splats, grid, mask, bounds, in_order=True))
        into, nodes = None, dr.width(splats.x)
        if frame is not None and frame.nodes:
            # What keeps its place in the frame need not be copied there.
            into, nodes = frame.radiance, nodes + frame.nodes
            frame.radiance = None
        image = rasterize_parts(self.arrays, splats, parts, into)
        return SplatImage(image, camera.width, camera.height, grid.padded_width, CHANNELS, nodes)

    def _check(self, entries: Sequence[AtlasEntry], cutoff: Lattice) -> None:
        count = len(self.forest.counts)
        for entry in entries:
            if not 1 <= entry.image.layer <= count:
                raise ValueError(f"layer {entry.image.layer}: the forest has layers 1 to {count}")
        if not (cutoff >= 0).all():
            raise ValueError(f"cut-off of {cutoff.min():g} cycles per pixel: must be 0 or more")

    def _least_blur(self, camera: Camera, image: LayerImage) -> float:
        """Minimum width of the filter, as a multiple of the filter at the pixel grid.

        The layer was trained with a filter of its training frames' pixels, and the sampling grid requires one
        of its own.
        """
        return max(camera.fy / self.forest.focal_of(image.layer), 2.0**image.rate)

    def _chosen(self, camera: Camera, entries: Sequence[AtlasEntry], cutoff: Lattice) -> list[Any]:
        """For each entry, indices of its layer's footprints that may show in its cells."""
        lowest = np.minimum.reduce(at_corners(cutoff))
        blurs = [
            max(0.5 / float(lowest[entry.cells].min()), self._least_blur(camera, entry.image))
            for entry in entries
        ]
        layers = [entry.image.layer for entry in entries]
        visible = self._footprints.layers(camera, max(blurs, default=1.0), layers)
        # At lower rates pixels look up samples that lie up to one sample away.
        margins = [2.0**entry.image.rate if entry.image.rate else 0.0 for entry in entries]
        masks = [
            None if nodes is None else touching(self.arrays, nodes, entry.cells, blur, margin)
            for entry, nodes, blur, margin in zip(entries, visible, blurs, margins, strict=True)
        ]
        dr.eval(masks)
        none = dr.zeros(self.arrays.plain.UInt, 0)
        return [none if mask is None else dr.compress(mask) for mask in masks]

    def _splats(
        self,
        camera: Camera,
        entries: Sequence[AtlasEntry],
        chosen: Sequence[Any],
        cutoff: Lattice,
        tile: int,
    ) -> tuple[Splats, TileBounds]:
        """The chosen nodes of all entries in samples of the atlas, and the tiles they are confined to."""
        UInt = self.arrays.plain.UInt
        raw = self._footprints.footprints([entry.image.layer for entry in entries], chosen)
        number, lane, start = UInt(0), dr.arange(UInt, dr.width(raw.x)), 0
        for part in chosen[:-1]:
            start += dr.width(part)
            number += dr.select(lane >= self.arrays.number(start), UInt(1), UInt(0))
        tops = [entry.top // tile for entry in entries]
        records = _ENTRY.upload(
            self.arrays,
            scale=[0.5**entry.image.rate for entry in entries],
            least_blur=[self._least_blur(camera, entry.image) for entry in entries],
            offset=[entry.top for entry in entries],
            columns=[entry.tiles.shape[1] for entry in entries],
            top=tops,
            bottom=[top + entry.tiles.shape[0] for top, entry in zip(tops, entries, strict=True)],
        )
        entry = records.at(number)
        # Fov-GS's Eq. 8, corrected: variance c (ppd / 2f)^2 px^2.
        resolved = 0.5 / _interpolated(self.arrays, cutoff, raw.x, raw.y)
        splats = filtered(raw, PIXEL_FILTER * dr.square(dr.maximum(resolved, entry.least_blur)))
        bounds = TileBounds(entry.columns, entry.top, entry.bottom)
        return _in_samples(splats, entry.scale, entry.offset), bounds


def tile_side(rates: Iterable[int]) -> int:
    """Side of the rasterizer's tiles, in samples, for an atlas of images at these rates."""
    return TILE if all(rate == 0 for rate in rates) else _COARSE_TILE


def finest_frequency(camera: Camera, forest: Forest, layer: int) -> float:
    """Highest frequency that a layer was trained to show, in cycles per pixel of a camera."""
    return 0.5 * forest.focal_of(layer) / camera.fy


def _in_samples(splats: Splats, scale: Any, offset: Any) -> Splats:
    """Splats in pixels of the frame as splats in samples of the atlas."""
    square = dr.rcp(dr.square(scale))
    return Splats(
        splats.x * scale,
        dr.fma(splats.y, scale, offset),
        splats.x_precision * square,
        splats.shear,
        splats.y_precision * square,
        *(splats.opacity, splats.red, splats.green, splats.blue, splats.depth),
    )


def _interpolated(arrays: Arrays, lattice: Lattice, x: Any, y: Any) -> Any:
    """Values of a lattice with a point every TILE pixels, linear in between, at positions in pixels."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    rows, columns = (arrays.number(side) for side in lattice.shape)
    values = Float(lattice.ravel())
    u = dr.clip(x * (1 / TILE), 0, Float(columns) - 1.001)
    v = dr.clip(y * (1 / TILE), 0, Float(rows) - 1.001)
    column, row = UInt(u), UInt(v)
    fu, fv = u - Float(column), v - Float(row)
    corner = row * columns + column
    at = lambda offset: dr.gather(Float, values, corner + offset)  # noqa: E731
    return dr.lerp(dr.lerp(at(0), at(1), fu), dr.lerp(at(columns), at(columns + 1), fu), fv)


def _largest_alone(images: Sequence[LayerImage], wanted: Mask) -> tuple[LayerImage | None, Mask]:
    """The image at full rate that is alone in most wanted cells, and those; None if that are few."""
    found = [(image, _is_alone(image.weight) & wanted) for image in images if image.rate == 0]
    best = max(found, key=lambda one: np.count_nonzero(one[1]), default=None)
    if best is None or np.count_nonzero(best[1]) < _WORTHWHILE * np.count_nonzero(wanted):
        return None, np.zeros_like(wanted)
    return best


def _is_alone(weight: Lattice) -> Mask:
    """(rows, columns) cells in which a weight, given at their corners, is 1 everywhere."""
    return np.minimum.reduce(at_corners(weight)) >= 1
