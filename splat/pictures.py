"""Several pictures of one view in one pass, each of one layer at one sampling rate, joined into one frame.

A layer is drawn where it has a share in the frame, at the rate that is needed there, and the pictures are
joined by their shares, pixel by pixel. Mixing the Gaussians of two layers in one list instead, each with a
part of its opacity, as Fov-GS does, lets the coarse ones hide the fine ones: half-way between two layers
that costs 2.7 dB on `room` (29.2 against 31.8 dB at 256 x 256).

All pictures share one projection, one sorting and one rasterization: they lie below each other in one
image. A picture at rate r has one sample per 2^r x 2^r pixels, in their middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.view import Camera
from splat.arrays import Arrays
from splat.binning import TILE, Panels, bin_splats
from splat.forest import Forest
from splat.gaussians import Gaussians
from splat.joining import Lattice, Panel, Picture, join, lay_out
from splat.project import PIXEL_FILTER, Parameters, Splats, project, view_position
from splat.raster import CHANNELS, padded_size, rasterize

# Standard deviations at which the most opaque Gaussian falls to 1/255.
_REACH = 3.33
# Side of a tile in samples, where samples are larger than pixels: few splats cover many of those.
_COARSE_TILE = 8
# Floats that one load brings.
_LOAD = 8


@dataclass
class JoinedFrame:
    """A frame joined from pictures.

    Attributes:
        radiance: flat float buffer, rows of stride x channels, the first three of which are radiance; black
            where no picture has a share.
        width, height: frame in pixels.
        stride, channels: width of the buffer in pixels, and floats per pixel.
        nodes: Gaussians drawn, those of several pictures counted in each.
    """

    radiance: Any
    width: int
    height: int
    stride: int
    channels: int
    nodes: int

    def image(self) -> NDArray[np.float32]:
        """(H, W, 3) float32 view of the radiance."""
        return self.radiance.numpy().reshape(-1, self.stride, self.channels)[: self.height, : self.width, :3]


class ForestRenderer:
    """Renders a forest that stays on the device.

    Args:
        arrays: the backend's array types.
        forest: what to draw.
    """

    def __init__(self, arrays: Arrays, forest: Forest):
        self.arrays, self.forest = arrays, forest
        self._nodes = _NodeTable(arrays, forest.nodes.gaussians)
        first = np.cumsum([0, *forest.counts])
        self._layers = [
            _Places(arrays, forest.nodes.gaussians, int(first[n]), int(first[n + 1]))
            for n in range(len(forest.counts))
        ]

    def render(
        self, camera: Camera, pictures: Sequence[Picture], cutoff: Lattice, wanted: NDArray[np.bool_]
    ) -> JoinedFrame:
        """The frame that the pictures make up.

        Args:
            camera: the view.
            pictures: of layers and rates; their shares sum to 1 wherever something is wanted.
            cutoff: (rows + 1, columns + 1) highest frequency that need be kept, in cycles per pixel, at the
                corners of cells of TILE pixels.
            wanted: (rows, columns) bool, cells that are drawn at all.
        """
        pictures = [p for p in pictures if bool((p.share > 0).any())]
        tile = TILE if all(p.rate == 0 for p in pictures) else _COARSE_TILE
        panels = lay_out(pictures, wanted, tile)
        touching = [self._touching(camera, panel, cutoff) for panel in panels]
        dr.eval(touching)
        chosen = [dr.compress(mask) for mask in touching]
        if not any(dr.width(index) for index in chosen):
            return self._black(camera)
        splats, confined = self._projected(camera, panels, chosen, cutoff, tile)
        columns = max(panel.tiles.shape[1] for panel in panels)
        mask = np.vstack(
            [np.pad(panel.tiles, ((0, 0), (0, columns - panel.tiles.shape[1]))) for panel in panels]
        )
        size = columns * tile, mask.shape[0] * tile
        bins = bin_splats(self.arrays, splats, *size, mask, confined, tile)
        image = rasterize(self.arrays, splats, bins)
        stride, channels = padded_size(bins)[0], CHANNELS
        if not _is_whole(panels):
            image = join(self.arrays, panels, image, stride, camera.width, camera.height)
            stride, channels = -(-camera.width // TILE) * TILE, 3
        return JoinedFrame(image, camera.width, camera.height, stride, channels, dr.width(splats.x))

    def _black(self, camera: Camera) -> JoinedFrame:
        stride, rows = -(-camera.width // TILE) * TILE, -(-camera.height // TILE) * TILE
        black = dr.zeros(self.arrays.plain.Float, stride * rows * 3)
        return JoinedFrame(black, camera.width, camera.height, stride, 3, 0)

    def render_layer(self, camera: Camera, layer: int) -> JoinedFrame:
        """A layer alone, over the whole frame at full rate."""
        cells = (-(-camera.height // TILE), -(-camera.width // TILE))
        corners = (cells[0] + 1, cells[1] + 1)
        picture = Picture(layer, 0, np.ones(corners, np.float32))
        return self.render(camera, [picture], np.full(corners, 0.5, np.float32), np.ones(cells, dtype=bool))

    def _least_blur(self, camera: Camera, picture: Picture) -> float:
        """The filter's width never falls below this, in units of that at the pixel grid.

        That is what the layer was trained with, seen at this camera's scale, and what the sampling grid
        asks for.
        """
        return max(camera.fy / self.forest.focal_of(picture.layer), 2.0**picture.rate)

    def _touching(self, camera: Camera, panel: Panel, cutoff: Lattice) -> Any:
        """Which nodes of the panel's layer may show in its cells, a mask."""
        UInt, Int = self.arrays.plain.UInt, self.arrays.plain.Int
        picture, places = panel.picture, self._layers[panel.picture.layer - 1]
        seen, x, y, spread = view_position(self.arrays, places.means, camera)
        near = np.minimum.reduce([cutoff[:-1, :-1], cutoff[1:, :-1], cutoff[:-1, 1:], cutoff[1:, 1:]])
        blur = max(0.5 / float(near[panel.cells].min()), self._least_blur(camera, picture))
        # At lower rates pixels look up samples that lie up to one sample away.
        beyond = 2.0**picture.rate if picture.rate else 0.0
        variance = dr.square(places.size * spread) + PIXEL_FILTER * blur**2
        reach = dr.fma(dr.sqrt(variance), _REACH, beyond)
        # Not for what is not a number, nor for what has no end.
        seen &= reach < np.inf
        # With sums over all cells above and to the left, any box takes four look-ups.
        rows, columns = panel.cells.shape
        sums = np.zeros((rows + 1, columns + 1), dtype=np.int32)
        sums[1:, 1:] = panel.cells.cumsum(axis=0).cumsum(axis=1)
        table = Int(sums.ravel())
        left, top = (UInt(dr.clip((v - reach) * (1 / TILE), 0, n)) for v, n in ((x, columns), (y, rows)))
        right, bottom = (
            UInt(dr.ceil(dr.clip((v + reach) * (1 / TILE), 0, n))) for v, n in ((x, columns), (y, rows))
        )
        at = lambda row, column: dr.gather(Int, table, row * (columns + 1) + column, seen)  # noqa: E731
        touches = at(bottom, right) - at(top, right) - at(bottom, left) + at(top, left) > 0
        return seen & touches

    def _projected(
        self, camera: Camera, panels: Sequence[Panel], chosen: Sequence[Any], cutoff: Lattice, tile: int
    ) -> tuple[Splats, Panels]:
        """The chosen nodes of all panels in samples of the image that holds them, and where they may be drawn."""
        Float, UInt = self.arrays.plain.Float, self.arrays.plain.UInt
        firsts = [self._layers[panel.picture.layer - 1].first for panel in panels]
        # Arithmetic with arrays of no width is refused.
        index = dr.concat(
            [part + first for part, first in zip(chosen, firsts, strict=True) if dr.width(part)]
        )
        number, lane, start = UInt(0), dr.arange(UInt, dr.width(index)), 0
        for part in chosen[:-1]:
            start += dr.width(part)
            number += dr.select(lane >= dr.opaque(UInt, start), UInt(1), UInt(0))
        per_panel = self.arrays.records(
            [
                Float([float(value) for value in values])
                for values in zip(*(self._row_of(camera, panel, tile) for panel in panels), strict=True)
            ]
        )
        scale, least, offset, columns, top, bottom, _, _ = self.arrays.record(per_panel, number, _LOAD)
        parameters = self._nodes.parameters(index)
        _, x, y, _ = view_position(self.arrays, parameters.means, camera)
        # Fov-GS's Eq. 8, mended: variance c (ppd / 2f)^2 px^2.
        resolved = 0.5 / _interpolated(self.arrays, cutoff, x, y)
        low_pass = PIXEL_FILTER * dr.square(dr.maximum(resolved, least))
        splats = project(self.arrays, parameters, camera, low_pass)
        return _in_samples(splats, scale, offset), Panels(columns, top, bottom)

    def _row_of(self, camera: Camera, panel: Panel, tile: int) -> tuple[float, ...]:
        """What splats need to know of their panel: scale, least blur, first row, and its tiles' bounds."""
        rows, columns = panel.tiles.shape
        top = panel.top // tile
        least = self._least_blur(camera, panel.picture)
        return 0.5**panel.picture.rate, least, panel.top, columns, top, top + rows, 0.0, 0.0


class _Places:
    """Where the nodes of one layer are, and how large: enough to see whether they show.

    Attributes:
        first: index of the first in the forest.
        means: three rows.
        size: longest axis, as a standard deviation.
    """

    def __init__(self, arrays: Arrays, gaussians: Gaussians, first: int, end: int):
        plain = lambda row: dr.detach(arrays.from_torch(row), preserve_type=False)  # noqa: E731
        self.first = first
        self.means = [plain(row) for row in gaussians.means[:, first:end]]
        self.size = plain(gaussians.log_scales[:, first:end].max(dim=0).values.exp())


class _NodeTable:
    """All parameters of a node side by side, as nodes are picked from all over the forest."""

    def __init__(self, arrays: Arrays, gaussians: Gaussians):
        self.arrays = arrays
        self._coefficients = gaussians.sh.shape[0]
        rows = [*gaussians.means, *gaussians.log_scales, *gaussians.rotations, gaussians.opacity_logits]
        rows += list(gaussians.sh.reshape(-1, len(gaussians)))
        self._loads = -(-len(rows) // _LOAD)
        table = np.zeros((len(gaussians), self._loads * _LOAD), dtype=np.float32)
        for column, row in enumerate(rows):
            table[:, column] = row.numpy()
        self._table = arrays.plain.Float(table.ravel())

    def parameters(self, index: Any) -> Parameters:
        """Of the nodes at these indices."""
        values: list[Any] = []
        for load in range(self._loads):
            values += self.arrays.record(self._table, index * self._loads + load, _LOAD)
        colours = values[11 : 11 + 3 * self._coefficients]
        sh = [colours[3 * k : 3 * k + 3] for k in range(self._coefficients)]
        return Parameters(values[:3], values[3:6], values[6:10], values[10], sh)


def finest_frequency(camera: Camera, forest: Forest, layer: int) -> float:
    """Highest frequency that a layer was trained to show, in cycles per pixel of a camera."""
    return 0.5 * forest.focal_of(layer) / camera.fy


def _in_samples(splats: Splats, scale: Any, offset: Any) -> Splats:
    """Splats in pixels of the frame as splats in samples of their panel."""
    square = dr.rcp(dr.square(scale))
    return Splats(
        splats.x * scale,
        dr.fma(splats.y, scale, offset),
        splats.xx * square,
        splats.xy * square,
        splats.yy * square,
        *(splats.opacity, splats.red, splats.green, splats.blue, splats.depth),
    )


def _interpolated(arrays: Arrays, lattice: Lattice, x: Any, y: Any) -> Any:
    """A lattice with a point every TILE pixels, linear in between, at positions in pixels."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    rows, columns = lattice.shape
    values = Float(lattice.ravel())
    u = dr.clip(x * (1 / TILE), 0, columns - 1.001)
    v = dr.clip(y * (1 / TILE), 0, rows - 1.001)
    column, row = UInt(u), UInt(v)
    fu, fv = u - Float(column), v - Float(row)
    corner = row * columns + column
    at = lambda offset: dr.gather(Float, values, corner + offset)  # noqa: E731
    return dr.lerp(dr.lerp(at(0), at(1), fu), dr.lerp(at(columns), at(columns + 1), fu), fv)


def _is_whole(panels: Sequence[Panel]) -> bool:
    """Whether one picture at full rate is all there is: it is the frame."""
    picture = panels[0].picture
    return len(panels) == 1 and picture.rate == 0 and bool((picture.share == 1).all())
