"""Plain twins, of NumPy, of what the product holds on the device, and the way from one to the other."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import Arrays, uploaded
from compose.base.traced_samples import Counts
from compose.fovea.disc import Disc
from compose.fovea.reprojection import EarlierView, Reprojected
from compose.fovea.samples import Samples
from compose.image.device_image import DeviceImage, shape_of

Floats = NDArray[np.float32]


def floats(arrays: Arrays, values: Any) -> Any:
    """Float (D,) of values (D,)."""
    return uploaded(arrays.plain.Float, np.asarray(values, dtype=np.float32))


def indices(arrays: Arrays, values: Any) -> Any:
    """UInt (D,) of values (D,)."""
    return uploaded(arrays.plain.UInt, np.asarray(values, dtype=np.uint32))


def channels(arrays: Arrays, values: Any) -> list[Any]:
    """Floats (D,), the columns of values (D, C)."""
    return [floats(arrays, column) for column in np.asarray(values).T]


def host(values: list[Any]) -> Floats:
    """(D, C) columns, C Floats (D,)."""
    return np.stack([np.array(column) for column in values], axis=-1)


def image_on(arrays: Arrays, image: Any) -> DeviceImage:
    """A copy on the device of an image (H, W, 3)."""
    height, width = image.shape[:2]
    return DeviceImage(arrays, floats(arrays, image), width, height, width)


def numbers(samples: Samples, name: str) -> NDArray[Any]:
    """(D,) or (D, 3) copy of an attribute or of the variance of samples on the device."""
    values = samples.variance() if name == "variance" else getattr(samples, name)
    return host(values) if isinstance(values, list) else np.array(values)


def disc_of(arrays: Arrays, width: int, height: int, pixels: Any, weights: Any) -> Disc:
    """A disc of (D,) pixels of a frame, in ascending order, and their weights."""
    box = None
    if len(pixels):
        row, column = np.divmod(pixels, width)
        box = tuple(slice(int(at.min()), int(at.max()) + 1) for at in (row, column))
    return Disc(arrays, width, height, indices(arrays, pixels), floats(arrays, weights), box)


def each_of(counts: int | Counts, size: int) -> NDArray[np.int64]:
    """(D,) what is said of the number of samples of D pixels, which must be consistent."""
    if isinstance(counts, int):
        return np.full(size, counts)
    each = np.array(counts.each).astype(np.int64)
    assert each.shape == (size,)
    assert each.sum() == counts.total
    assert each.max() <= counts.most
    return each


@dataclass(frozen=True)
class PlainSamples:
    """Samples of D pixels: pixels, count, gloss, mover and earlier (D,), everything else (D, 3)."""

    pixels: NDArray[np.uint32]
    count: Floats
    radiance: Floats
    squares: Floats
    albedo: Floats
    normal: Floats
    position: Floats
    gloss: NDArray[np.uint8]
    mover: NDArray[np.uint16]
    earlier: Floats

    @staticmethod
    def of(samples: Samples) -> PlainSamples:
        """A copy of samples on the device."""
        return PlainSamples(*(numbers(samples, field.name) for field in fields(PlainSamples)))

    def on(self, arrays: Arrays) -> Samples:
        """A copy on the device."""
        numbers = (self.count, self.radiance, self.squares, self.albedo, self.normal, self.position)
        light = (channels(arrays, v) if v.ndim == 2 else floats(arrays, v) for v in numbers)
        kinds = (floats(arrays, kind) for kind in (self.gloss, self.mover, self.earlier))
        return Samples(indices(arrays, self.pixels), *light, *kinds)

    def part(self, chosen: Any) -> PlainSamples:
        """Some of the pixels, by an index among the D."""
        return PlainSamples(*(getattr(self, field.name)[chosen] for field in fields(PlainSamples)))

    def box(self, width: int) -> tuple[slice, slice]:
        """Rows and columns of the rectangle around the pixels of a frame of that width; empty without any."""
        if not len(self.pixels):
            return slice(0, 0), slice(0, 0)
        row, column = np.divmod(self.pixels.astype(np.int64), width)
        return tuple(slice(int(at.min()), int(at.max()) + 1) for at in (row, column))  # type: ignore[return-value]


@dataclass(frozen=True)
class PlainView:
    """An EarlierView: records (N, 16), position (N, 3), gloss and mover (N,)."""

    records: Floats
    position: Floats
    gloss: NDArray[np.uint8]
    mover: NDArray[np.uint16]
    viewpoint: NDArray[np.float64]
    time: float = 0.0

    def on(self, arrays: Arrays) -> EarlierView:
        """A copy on the device."""
        tables = (channels(arrays, table) for table in (self.records, self.position))
        kinds = (floats(arrays, kind) for kind in (self.gloss, self.mover))
        return EarlierView(*tables, *kinds, self.viewpoint, self.time)


@dataclass(frozen=True)
class PlainReprojected:
    """Sums (h, w, 16) over reprojected samples, for the rows and columns of a frame."""

    rows: slice
    columns: slice
    records: NDArray[np.floating[Any]]

    @staticmethod
    def of(found: Reprojected) -> PlainReprojected:
        """A copy of what is on the device."""
        return PlainReprojected(*found.box, np.array(found.records).reshape(*shape_of(found.box), -1))
