"""Images of single layers, each at one sampling rate, and the atlas that holds all images of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splat.raster.tiles import TILE

Lattice = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class LayerImage:
    """One layer at one sampling rate, and its weight in the frame.

    Attributes:
        layer: 1, the coarsest, to L.
        rate: log2 of pixels per sample along each axis, 0 for every pixel.
        weight: (rows + 1, columns + 1) weight in the frame, 0..1, at the corners of cells of TILE pixels,
            linear between them.
    """

    layer: int
    rate: int
    weight: Lattice


@dataclass(frozen=True)
class AtlasEntry:
    """A layer image's place in the atlas, the image that holds all layer images one above the other.

    Attributes:
        image: what it shows.
        top: its first row of samples in the atlas.
        tiles: (tile rows, tile columns) bool, its tiles that are drawn.
        cells: (rows, columns) bool, cells of TILE pixels of the frame in which its weight is not 0.
    """

    image: LayerImage
    top: int
    tiles: Mask
    cells: Mask


def pack_atlas(images: Sequence[LayerImage], wanted: Mask, tile: int) -> list[AtlasEntry]:
    """Atlas entries of the images that show in the wanted cells.

    Args:
        images: the layer images.
        wanted: (rows, columns) bool, cells of the frame that are drawn at all.
        tile: side of the rasterizer's tiles, in samples.
    """
    entries, top = [], 0
    for image in images:
        cells = covered_cells(image.weight) & wanted
        if cells.any():
            # At lower rates, a pixel at the border of a cell looks up samples beyond it.
            tiles = _resized(_grown(cells) if image.rate else cells, TILE, tile << image.rate)
            entries.append(AtlasEntry(image, top, tiles, cells))
            top += tiles.shape[0] * tile
    return entries


def covered_cells(weight: Lattice) -> Mask:
    """(rows, columns) cells in which a weight, given at their corners, is not 0 everywhere."""
    return np.maximum.reduce(at_corners(weight)) > 0


def at_corners(lattice: Lattice) -> list[Lattice]:
    """A lattice at the four corners of each cell, (rows, columns) each."""
    return [lattice[:-1, :-1], lattice[1:, :-1], lattice[:-1, 1:], lattice[1:, 1:]]


def _resized(mask: Mask, cell: int, tile: int) -> Mask:
    """Tiles that hold any set cell.

    Args:
        mask: (rows, columns) bool, cells.
        cell, tile: sides in pixels, one a multiple of the other.
    """
    if tile < cell:
        return mask.repeat(cell // tile, axis=0).repeat(cell // tile, axis=1)
    size = tile // cell
    rows, columns = -(-mask.shape[0] // size), -(-mask.shape[1] // size)
    padded = np.zeros((rows * size, columns * size), dtype=bool)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    return np.asarray(padded.reshape(rows, size, columns, size).any(axis=(1, 3)))


def _grown(mask: Mask) -> Mask:
    """The mask and the eight neighbours of each of its cells."""
    tall = mask.copy()
    tall[1:] |= mask[:-1]
    tall[:-1] |= mask[1:]
    grown = tall.copy()
    grown[:, 1:] |= tall[:, :-1]
    grown[:, :-1] |= tall[:, 1:]
    return grown
