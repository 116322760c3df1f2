"""Images of a forest on the device: of single layers at one sampling rate each, in an atlas; of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import drjit as dr
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from compose.image.device_image import DeviceImage
from splat.raster.tiles import TILE, TileGrid

Lattice = NDArray[np.float32]
Mask = NDArray[np.bool_]
_Kind = TypeVar("_Kind", bound=np.generic)
# Highest frequency that samples carry, in cycles per sample.
NYQUIST = 0.5
# In place of a layer: the nodes of the forest's hierarchy that levels ask for (`splat.raster.cut`).
CONTINUOUS = 0


@dataclass(frozen=True)
class LayerImage:
    """One layer at one sampling rate, and its weight in the frame."""

    layer: int  # 1, the coarsest, to L; or CONTINUOUS
    rate: int  # log2 of pixels per sample along each axis, 0 for every pixel
    # (rows + 1, columns + 1) weight in the frame, 0..1, at the corners of cells, linear between them
    weight: Lattice

    @staticmethod
    def whole(layer: int, rate: int, cells: tuple[int, ...]) -> LayerImage:
        """A layer alone over a frame of so many rows and columns of cells."""
        return LayerImage(layer, rate, np.ones((cells[0] + 1, cells[1] + 1), np.float32))


@dataclass(frozen=True)
class AtlasEntry:
    """A layer image's place in the atlas, the image that holds all layer images one above the other."""

    image: LayerImage  # what it shows
    top: int  # the row of samples in the atlas at which the frame's first row would be
    tiles: Mask  # (tile rows, tile columns) bool, its tiles that are drawn
    cells: Mask  # (rows, columns) bool, cells of TILE pixels of the frame in which its weight is not 0
    first_row: int = 0  # of its tiles, counted from the frame's; those above have no place in the atlas
    is_sharp: bool = False  # whether it keeps all that its samples carry, whatever the frame's cut-off

    @property
    def tile_rows(self) -> range:
        """Its rows of tiles in the atlas."""
        start = self.top // TILE + self.first_row
        return range(start, start + self.tiles.shape[0])


@dataclass(frozen=True)
class AtlasPart:
    """Entries of an atlas that make an image, and its rows of tiles."""

    entries: list[AtlasEntry]
    height: int

    @staticmethod
    def of(entries: list[AtlasEntry], step: int = 1) -> AtlasPart:
        """Some entries as an image whose height is a multiple of a number of tiles."""
        rows = sum(len(entry.tile_rows) for entry in entries)
        return AtlasPart(entries, -(-rows // step) * step)


@dataclass(frozen=True)
class Under:
    """What is drawn besides a frame, to lie under it: a layer at full rate with all that it resolves."""

    layer: int  # 1, the coarsest, to L; or CONTINUOUS
    cells: Mask  # (rows, columns) bool, cells of TILE pixels of the frame

    def entry(self, top: int) -> AtlasEntry:
        """Its entry in an atlas, whose first free row of samples is `top`; at least one cell is set."""
        rows = np.flatnonzero(self.cells.any(axis=1))
        first, end = int(rows[0]), int(rows[-1]) + 1
        image = LayerImage.whole(self.layer, 0, self.cells.shape)
        return AtlasEntry(image, top - first * TILE, self.cells[first:end], self.cells, first, True)


def pack_atlas(images: Sequence[LayerImage], wanted: Mask, top: int = 0) -> list[AtlasEntry]:
    """Atlas entries of the images that show in wanted cells (rows, columns), from row `top` of samples on."""
    entries = []
    for image in images:
        cells = covered_cells(image.weight) & wanted
        if cells.any():
            # At lower rates, a pixel at the border of a cell looks up samples beyond it.
            tiles = _joined(_grown(cells), 1 << image.rate) if image.rate else cells
            entries.append(AtlasEntry(image, top, tiles, cells))
            top += tiles.shape[0] * TILE
    return entries


def covered_cells(weight: Lattice) -> Mask:
    """(rows, columns) cells in which a weight, given at their corners, is not 0 everywhere."""
    return np.maximum.reduce(at_corners(weight)) > 0


def at_corners(lattice: NDArray[_Kind]) -> list[NDArray[_Kind]]:
    """A lattice at the four corners of each cell, (rows, columns) each."""
    return [lattice[:-1, :-1], lattice[1:, :-1], lattice[:-1, 1:], lattice[1:, 1:]]


def touched_corners(cells: Mask) -> Mask:
    """(rows + 1, columns + 1) the corners of cells that are set."""
    touched = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1), dtype=bool)
    for corner in at_corners(touched):
        corner |= cells
    return touched


def _joined(mask: Mask, size: int) -> Mask:
    """Tiles of so many cells a side that hold any set cell of a mask (rows, columns)."""
    padded = np.pad(mask, [(0, -side % size) for side in mask.shape])
    blocks = padded.reshape(len(padded) // size, size, -1, size)
    return np.asarray(blocks.any(axis=(1, 3)))


def _grown(mask: Mask) -> Mask:
    """The mask and the eight neighbours of each of its cells; ten times as quick as SciPy's dilation."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    grown = tall.copy()
    grown[:, 1:] |= tall[:, :-1]
    grown[:, :-1] |= tall[:, 1:]
    return grown


@dataclass(frozen=True)
class SplatImage(DeviceImage):
    """An image of a forest, black where nothing is drawn."""

    nodes: int = 0  # Gaussians drawn, those in several layer images counted in each


def black_image(arrays: Arrays, camera: Camera, nodes: int = 0) -> SplatImage:
    """A black image of a camera's size."""
    grid = TileGrid(camera.width, camera.height)
    black = dr.zeros(arrays.plain.Float, grid.padded_width * grid.padded_height * 3)
    return SplatImage(arrays, black, camera.width, camera.height, grid.padded_width, nodes=nodes)
