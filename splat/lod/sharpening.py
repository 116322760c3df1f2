"""Sharpens samples by what linear interpolation between them will take away.

At a distance t from a sample, in samples, a line between two of them keeps 1 - t (1 - t) w^2 / 2 of a wave of
w radians per sample. On average w^2 / 12 is lost, which a Laplacian filter of that weight gives back. A cubic
between the samples would do the same, but for every pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.lod.image import SplatImage
from splat.lod.layer_images import AtlasEntry, grown
from splat.raster.blocks import PIXEL
from splat.raster.records import Records
from splat.raster.tiles import TILE

# Weight of each of the four neighbours.
_WEIGHT = 1 / 12
# A sample changes by at most this share of itself: beside a lamp it would fall far below zero.
_MOST = 0.25


def sharpened(arrays: Arrays, entries: Sequence[AtlasEntry], atlas: SplatImage, camera: Camera) -> Records:
    """The atlas' samples at rates above 0 in and around the entries' cells; others are undefined.

    Args:
        arrays: the backend's array types.
        entries: of the atlas.
        atlas: the entries' samples, PIXEL records.
        camera: the view.
    """
    samples = Records(arrays, PIXEL, [atlas.radiance])
    if all(entry.image.rate == 0 for entry in entries):
        return samples
    result = dr.empty(arrays.plain.Float, dr.width(atlas.radiance))
    for entry in entries:
        if entry.image.rate:
            _sharpen(samples, entry, atlas.stride, camera, result)
    dr.eval(result)
    return Records(arrays, PIXEL, [result])


def _sharpen(samples: Records, entry: AtlasEntry, atlas_stride: int, camera: Camera, result: Any) -> None:
    """Writes the sharpened samples of one entry to the result, a flat buffer like that of the samples."""
    arrays, rate = samples.arrays, entry.image.rate
    UInt, Int = arrays.plain.UInt, arrays.plain.Int
    # Opaque like everything that changes with the camera or the gaze.
    top, stride = arrays.number(entry.top), arrays.number(atlas_stride)
    last_x, last_y = (
        Int((arrays.number(side) + ((1 << rate) - 1)) >> rate) - 1 for side in (camera.width, camera.height)
    )
    columns = arrays.number(entry.cells.shape[1])
    cells = UInt(np.flatnonzero(grown(entry.cells)).astype(np.uint32))
    across = TILE >> rate
    lane = dr.arange(UInt, dr.width(cells) * across**2)
    cell, within = dr.gather(UInt, cells, lane // across**2), lane % across**2
    row = cell // columns
    x = Int((cell - row * columns) * across + within % across)
    y = Int(row * across + within // across)

    def index(across: int, down: int) -> Any:
        """The sample so far to the right and below, or the nearest one inside the frame."""
        inside_x, inside_y = (dr.clip(v, 0, last) for v, last in ((x + across, last_x), (y + down, last_y)))
        return (top + UInt(inside_y)) * stride + UInt(inside_x)

    centre = samples.at(index(0, 0))
    around = [samples.at(index(*step)) for step in ((-1, 0), (1, 0), (0, -1), (0, 1))]
    channels = []
    for name in ("red", "green", "blue"):
        value = getattr(centre, name)
        change = _WEIGHT * (4 * value - sum(getattr(sample, name) for sample in around))
        most = _MOST * dr.abs(value)
        channels.append(value + dr.clip(change, -most, most))
    packet = arrays.plain.ArrayXf([*channels, dr.zeros(type(channels[0]), dr.width(lane))])
    dr.scatter(result, packet, index(0, 0), (x <= last_x) & (y <= last_y), mode=dr.ReduceMode.Permute)
