"""Renders several layers of a forest, each at its own sampling rate, and composites them into one frame.

Layer images are composited by their weights, pixel by pixel. Fov-GS instead blends the Gaussians of two
layers in one list, each with a part of its opacity, which lets the coarse ones hide the fine ones: half-way
between two layers that costs 2.7 dB on `room` (29.2 against 31.8 dB at 256 x 256).

All layer images share one projection, one sort and one rasterization: they lie one above the other in an
atlas. An image at rate r has one sample per 2^r x 2^r pixels, at their centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.base.frozen import Frozen, capacity
from compose.camera.camera import Camera
from splat.lod.compositing import Mixture, composite, composited
from splat.lod.footprints import ForestFootprints
from splat.lod.layer_images import (
    CONTINUOUS,
    NYQUIST,
    AtlasEntry,
    AtlasPart,
    EntryTable,
    Lattice,
    LayerImage,
    Mask,
    SplatImage,
    Under,
    at_corners,
    black_image,
    chosen,
    covered_cells,
    pack_atlas,
)
from splat.model.forest import Forest
from splat.model.gaussians import Blending
from splat.model.points import Bits
from splat.raster.binning import Boxed, Candidates, SortedPairs, TileBounds, boxed, lists, run_lengths
from splat.raster.blending import ImageSplit, blend, jumps
from splat.raster.blocks import CHANNELS
from splat.raster.parts import PAIRS_AT_ONCE, Parts, rasterize_parts
from splat.raster.projection import PIXEL_FILTER, Footprints, filtered, radiance_from_perceptual
from splat.raster.records import Records
from splat.raster.tiles import TILE, TileGrid

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt, UInt64

# Share of the wanted cells from which the cells of a single image are drawn where they belong.
_WORTHWHILE = 0.1
# Images of so many tiles have too few lanes to go round: theirs get a quarter of the pixels.
_FEW_TILES, _FINE_SPLIT = 64, 2
# Heights of images are rounded up so that a frame has about so many: recordings differ by height.
_HEIGHTS = 8
# Filters of this width, as a multiple of the filter at the pixel grid, leave nothing but the faintest haze.
_WIDEST_BLUR = 1e9


class ForestRenderer:
    """Renders a forest that stays on the device."""

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays, self.forest = arrays, forest
        self._encoded = forest.nodes.gaussians.blending is Blending.DISPLAY
        self._footprints = ForestFootprints(arrays, forest)

    def set_time(self, time: float) -> None:
        """Shows the forest at a time from 0 to 1; forests in which nothing moves look alike at all times."""
        self._footprints.set_time(time)

    def render(
        self,
        camera: Camera,
        images: Sequence[LayerImage],
        cutoff: Lattice,
        wanted: Mask,
        under: Under | None = None,
        levels: Lattice | None = None,
    ) -> tuple[SplatImage, SplatImage]:
        """Renders and composites layer images; the second image is to lie under the frame.

        Args:
            images: layers and rates; their weights sum to 1 wherever a cell is wanted.
            cutoff: (rows + 1, columns + 1) highest frequency to keep, in cycles per pixel, at the corners of
                cells of TILE pixels; 0 or more.
            wanted: (rows, columns) bool, cells that are drawn at all.
            under: what the second image shows, which is black elsewhere; None for nothing.
            levels: (rows + 1, columns + 1) over 0, standard deviation in pixels that nodes of continuous
                levels of detail may have, at the corners of cells; None if no image has those.

        Raises:
            ValueError: the forest has no such layer, or a cut-off is negative or not a number.
        """
        images = [image for image in images if bool((image.weight > 0).any())]
        own, alone = _largest_alone(images, wanted)
        # All share one list of splats; each of the three has its own image, one above the other.
        parts, step = [], max(1, len(wanted) // _HEIGHTS)
        if own is not None:
            parts.append(AtlasPart.of(pack_atlas([own], alone), step))
        if under is not None and under.cells.any():
            parts.append(AtlasPart.of([under.entry(_rows_of(parts))], step))
        # The cells in which images are drawn at a lower rate or mixed.
        mixed = pack_atlas(images, wanted & ~alone, _rows_of(parts))
        if mixed:
            parts.append(AtlasPart.of(mixed, step))
        drawn = self._drawn(camera, parts, cutoff, mixes=bool(mixed), over=own is not None, levels=levels)
        frame = drawn.pop(0) if own is not None or mixed else black_image(self.arrays, camera)
        return frame, drawn[0] if drawn else black_image(self.arrays, camera)

    def least_factor(self, camera: Camera, levels: Lattice, most: int) -> float:
        """What continuous levels must be multiplied by, 1 or more, for at most so many nodes to be drawn."""
        return self._footprints.least_factor(camera, levels, most)

    def differences(
        self, camera: Camera, levels: Lattice, visibility: Float, weights: Lattice
    ) -> NDArray[np.float64]:
        """Sums of visible differences, at each step of the levels' factor (`splat.raster.cut`)."""
        return self._footprints.differences(camera, levels, visibility, weights)

    def hold_cut(self, drawn: Bits) -> None:
        """Draws no other nodes of the hierarchy than these (N + M,), whatever levels ask for."""
        self._footprints.hold_cut(drawn)

    def render_layer(self, camera: Camera, layer: int, rate: int = 0) -> SplatImage:
        """One layer over the whole frame, (H / 2^rate, W / 2^rate) samples; ValueError if there is none."""
        grid = TileGrid(camera.width, camera.height)
        image = LayerImage.whole(layer, rate, (grid.rows, grid.columns))
        part = AtlasPart.of(pack_atlas([image], grid.mask(None)))
        (samples,) = self._drawn(camera, [part], NYQUIST * image.weight, rate)
        return replace(samples, width=-(-camera.width >> rate), height=-(-camera.height >> rate))

    def _drawn(
        self,
        camera: Camera,
        parts: Sequence[AtlasPart],
        cutoff: Lattice,
        rate: int = 0,
        mixes: bool = False,
        over: bool = False,
        levels: Lattice | None = None,
    ) -> list[SplatImage]:
        """An image of each part, which lie one above the other; all count the nodes of all.

        If it `mixes`, the last part is composited: into the first image if it lies `over` that, or into one
        that comes before all. `rate` is the finest that entries may have.
        """
        arrays, entries = self.arrays, [entry for part in parts for entry in part.entries]
        self._check(entries, cutoff, levels)
        table = self._table(camera, entries, cutoff, levels) if entries else None
        black = [black_image(arrays, camera) for _ in parts[mixes and over :]]
        if table is None:
            return black
        footprints = self._footprints.records
        found, end = _chosen(arrays, table, footprints)
        # Here, the host waits.
        nodes = int(end[table.capacity - 1])
        if not nodes:
            return black
        # The tiles of the atlas that are drawn.
        columns = max(entry.tiles.shape[1] for entry in entries)
        mask = np.zeros((sum(part.height for part in parts), columns), dtype=bool)
        for entry in entries:
            mask[entry.tile_rows.start : entry.tile_rows.stop, : entry.tiles.shape[1]] = entry.tiles
        # So many tiles of the rasterizer lie along the side of one of the atlas.
        shown = TileGrid(max(1, camera.width >> rate), max(1, camera.height >> rate))
        split = _FINE_SPLIT if shown.columns * shown.rows <= _FEW_TILES else 1
        grid = TileGrid(columns * TILE, len(mask) * TILE, TILE // split)
        sizes = arrays.constant(nodes), capacity(nodes), split, self._encoded
        splats, ends, lengths = _splats(arrays, table, footprints, found, *sizes)
        mask, mixture = mask.repeat(split, axis=0).repeat(split, axis=1), None
        if mixes:
            top = _rows_of(parts[:-1])
            placed = [replace(entry, top=entry.top - top) for entry in parts[-1].entries]
            mixture = Mixture.of(arrays, placed, grid.padded_width, camera)
        candidates = Candidates(arrays, splats, grid, mask, None, (ends, lengths))
        heights, finish = [split * part.height for part in parts], Finish(mixture, over, self._encoded)
        images = _drawn_images(arrays, candidates, heights, finish)
        size, firsts = (camera.width, camera.height), [part.entries[0].first_row * TILE for part in parts]
        shapes = [(grid.padded_width, CHANNELS, first) for first in firsts]
        if mixes:
            shapes = shapes[:-1] if over else [(TileGrid(*size).padded_width, 3, 0), *shapes[:-1]]
        return [
            SplatImage(arrays, image, *size, *shape, nodes)
            for image, shape in zip(images, shapes, strict=True)
        ]

    def _check(self, entries: Sequence[AtlasEntry], cutoff: Lattice, levels: Lattice | None) -> None:
        count, least = len(self.forest.counts), 1 if levels is None else CONTINUOUS
        for entry in entries:
            if not least <= entry.image.layer <= count:
                raise ValueError(f"layer {entry.image.layer}: the forest has layers 1 to {count}")
        if not (cutoff >= 0).all():
            raise ValueError(f"cut-off of {cutoff.min():g} cycles per pixel: must be 0 or more")

    def _table(
        self, camera: Camera, entries: Sequence[AtlasEntry], cutoff: Lattice, levels: Lattice | None
    ) -> EntryTable | None:
        """The entries and the footprints that may show in them; None if there is none."""
        # A cut-off of 0 is that of the widest filter.
        cutoff = np.maximum(cutoff, NYQUIST / _WIDEST_BLUR, dtype=np.float32)
        lowest, blurs = np.minimum.reduce(at_corners(cutoff)), []
        for entry in entries:
            # Both the pixels of its training frames and the grid of samples require a filter.
            layer = len(self.forest.counts) if entry.image.layer == CONTINUOUS else entry.image.layer
            least = max(camera.fy / self.forest.focal_of(layer), 2.0**entry.image.rate)
            kept = NYQUIST if entry.is_sharp else float(lowest[entry.cells].min())
            blurs.append((max(NYQUIST / kept, least), least))
        widest = max(blur for blur, _ in blurs)
        nodes = self._footprints.layers(camera, widest, [entry.image.layer for entry in entries], levels)
        if not any(map(len, nodes)):
            return None
        return EntryTable.of_entries(self.arrays, entries, nodes, blurs, cutoff)


def _rows_of(parts: Sequence[AtlasPart]) -> int:
    return TILE * sum(part.height for part in parts)


def splats_of_candidates(
    arrays: Arrays,
    table: EntryTable,
    footprints: Records,
    found: UInt,
    count: UInt,
    size: int,
    split: int,
    encoded: bool,
) -> tuple[Boxed, UInt64, UInt]:
    """Candidates in samples of the atlas, boxed for its tiles, and their `run_lengths`.

    Args:
        found: (N,) numbers of the candidates, of which the first `count` are drawn.
        size: of the result, at least that.
        split: tiles of the rasterizer along the side of one of the atlas.
    """
    lane = dr.arange(arrays.plain.UInt, size)
    known = lane < count
    entry, node = table.of(dr.gather(arrays.plain.UInt, found, lane, known))
    raw = Footprints(**vars(footprints.at(node)))
    # Fov-GS's Eq. 8, corrected: variance c (ppd / 2f)^2 px^2.
    resolved = 0.5 / table.cutoff(entry, raw.x, raw.y)
    splats = filtered(raw, PIXEL_FILTER * dr.square(dr.maximum(resolved, entry.least_blur)), encoded)
    splats.opacity = dr.select(known, splats.opacity, 0)
    bounds = TileBounds(entry.columns * split, entry.top * split, entry.bottom * split)
    # From pixels of the frame to samples of the atlas.
    square = dr.rcp(dr.square(entry.scale))
    splats.x, splats.y = splats.x * entry.scale, dr.fma(splats.y, entry.scale, entry.offset)
    splats.x_precision, splats.y_precision = splats.x_precision * square, splats.y_precision * square
    result = boxed(arrays, splats, bounds, TILE // split)
    return result, *run_lengths(arrays, result.count, None)


@dataclass(frozen=True)
class Finish:
    """What becomes of the images of parts."""

    mixture: Mixture | None  # of the last one
    over: bool  # whether that is composited into the first one, or else into one before all
    encoded: bool  # whether they are of perceptual values, and become linear radiance

    def of(self, arrays: Arrays, images: list[Float]) -> list[Float]:
        """The images, finished; the last one is gone if there is a mixture."""
        if self.encoded:
            # The fourth channel is opacity.
            for number, image in enumerate(images):
                is_colour = dr.arange(arrays.plain.UInt, dr.width(image)) % CHANNELS < CHANNELS - 1
                images[number] = dr.select(is_colour, radiance_from_perceptual(image), image)
            dr.eval(images)
        if self.mixture is None:
            return images
        *others, atlas = images
        frame = others.pop(0) if self.over else None
        return [composited(arrays, self.mixture, atlas, frame), *others]


def _drawn_images(arrays: Arrays, candidates: Candidates, heights: list[int], finish: Finish) -> list[Float]:
    runs, split = candidates.runs(candidates.whole), ImageSplit.of(arrays, candidates.grid, heights)
    if not 0 < runs.pairs <= PAIRS_AT_ONCE:
        return finish.of(arrays, rasterize_parts(arrays, Parts(candidates), heights))
    pairs, _ = candidates.sorted(runs)
    jumping = jumps(arrays, runs.pairs, int(np.count_nonzero(candidates.wanted)))
    return _images(arrays, candidates.found.blended, pairs, split, jumping, finish)


def images_of_pairs(
    arrays: Arrays, blended: Records, pairs: SortedPairs, split: ImageSplit, jumping: bool, finish: Finish
) -> list[Float]:
    """Images of sorted candidates."""
    return finish.of(arrays, blend(arrays, blended, lists(arrays, pairs), split, jumping))


_chosen, _splats = Frozen(chosen, by_size=True), Frozen(splats_of_candidates, by_size=True)
_images = Frozen(images_of_pairs, by_size=True)


def finest_frequency(camera: Camera, forest: Forest, layer: int) -> float:
    """Highest frequency that a layer was trained to show, in cycles per pixel of a camera."""
    return 0.5 * forest.focal_of(layer) / camera.fy


def _largest_alone(images: Sequence[LayerImage], wanted: Mask) -> tuple[LayerImage | None, Mask]:
    """The image at full rate that is alone in most wanted cells, and those; None if that are few."""
    alone = lambda weight: np.minimum.reduce(at_corners(weight)) >= 1  # noqa: E731
    found = [(image, alone(image.weight) & wanted) for image in images if image.rate == 0]
    best = max(found, key=lambda one: np.count_nonzero(one[1]), default=None)
    least = max(1, _WORTHWHILE * np.count_nonzero(wanted))
    if best is None or np.count_nonzero(best[1]) < least:
        return None, np.zeros_like(wanted)
    return best


class CachedLayerImages:
    """Layer images of one view, given by layer and rate, each drawn over the whole frame."""

    def __init__(self, renderer: ForestRenderer, camera: Camera, steps: Sequence[tuple[int, int]]):
        grid = TileGrid(camera.width, camera.height)
        images = [LayerImage.whole(layer, rate, (grid.rows, grid.columns)) for layer, rate in steps]
        part = AtlasPart.of(pack_atlas(images, grid.mask(None)))
        self._entries = part.entries
        self._arrays, self._camera = renderer.arrays, camera
        cutoff = np.full((grid.rows + 1, grid.columns + 1), NYQUIST, np.float32)
        (self._atlas,) = renderer._drawn(camera, [part], cutoff)

    def composite(self, weights: Sequence[Lattice], wanted: Mask) -> SplatImage:
        """The wanted cells (rows, columns) of TILE pixels of the frame.

        The weights of the images, (rows + 1, columns + 1) at the corners of cells, sum to 1 in wanted cells.
        """
        entries = [
            replace(entry, image=replace(entry.image, weight=weight), cells=cells)
            for entry, weight in zip(self._entries, weights, strict=True)
            if (cells := covered_cells(weight) & wanted).any()
        ]
        if not entries or not self._atlas.nodes:
            return black_image(self._arrays, self._camera, self._atlas.nodes)
        return composite(self._arrays, entries, self._atlas, self._camera)
