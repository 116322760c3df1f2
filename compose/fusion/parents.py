"""What is fused: images of one view, on the device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import Arrays, uploaded
from compose.fusion.maps import Grid
from compose.image.colour import Image

if TYPE_CHECKING:
    from drjit.auto.ad import Float, UInt

# What an estimate is made of, in the order of its weights.
PARENTS = ("traced", "denoised", "relit", "splat")
# Squared error of sRGB values, from 0 to 1, of splats of which nothing is known: that of a forest of 35 dB.
TYPICAL_ERROR = 3e-4
# Images that are fused, and their channels.
CHANNELS = {
    "traced": 3,  # mean of the path-traced samples, linear radiance
    "variance": 3,  # of that mean; inf where it is unknown
    "splat": 3,  # the splats, rendered for the same view
    "albedo": 3,  # of the same samples
    "count": 1,  # number of samples
    "earlier": 1,  # how many of these were reprojected from earlier views
}


@dataclass(frozen=True)
class Planes:
    """All channels of CHANNELS, one after the other, each row by row."""

    values: Float
    stride: UInt  # from one channel to the next, of width 1

    def at(self, name: str, index: UInt) -> list[Float]:
        """The channels of an image at row-major indices of pixels."""
        names = list(CHANNELS)
        first = sum(CHANNELS[other] for other in names[: names.index(name)])
        places = (index + self.stride * (first + k) for k in range(CHANNELS[name]))
        return [dr.gather(type(self.values), self.values, place) for place in places]


@dataclass(frozen=True)
class Parents:
    """Images of one view from which its radiance is estimated, on the device.

    Attributes:
        shape: (h, w), rows and columns.
        planes: all images but for one.
        denoised: Float (h * w * 3,), pixel by pixel: the same samples, denoised, unless that takes too long.
        expected: squared error of sRGB values, from 0 to 1, that is typical of the splats.
    """

    arrays: Arrays
    shape: tuple[int, int]
    planes: Planes
    denoised: Float | None = None
    expected: float = TYPICAL_ERROR

    @staticmethod
    def of(
        arrays: Arrays,
        shape: tuple[int, int],
        images: Mapping[str, Sequence[Float]],
        denoised: Float | None = None,
        expected: float = TYPICAL_ERROR,
    ) -> Parents:
        """Of channels (h * w,) by the names of CHANNELS; ValueError if sizes do not match."""
        size, plain = shape[0] * shape[1], arrays.plain
        for name, count in CHANNELS.items():
            widths = [dr.width(values) for values in images[name]]
            if widths != [size] * count:
                raise ValueError(f"{name} has channels of {widths} pixels, must have {count} of {size}")
        if denoised is not None and dr.width(denoised) != 3 * size:
            raise ValueError(f"denoised has {dr.width(denoised)} values, must have 3 of {size} pixels")
        values = dr.empty(plain.Float, size * sum(CHANNELS.values()))
        index, stride = dr.arange(plain.UInt, size), arrays.constant(size)
        channels = [values for name in CHANNELS for values in images[name]]
        for number, channel in enumerate(channels):
            place = index + stride * number
            dr.scatter(values, plain.Float(channel), place, mode=dr.ReduceMode.Permute)
        dr.eval(values)
        return Parents(arrays, shape, Planes(values, stride), denoised, expected)

    @staticmethod
    def of_images(arrays: Arrays, images: Mapping[str, Image], expected: float = TYPICAL_ERROR) -> Parents:
        """Of host images (h, w, C) by the names of CHANNELS and, if there are any, denoised samples."""
        upload = lambda image: uploaded(arrays.plain.Float, image.astype(np.float32))  # noqa: E731
        channels = {name: [upload(of) for of in np.moveaxis(images[name], 2, 0)] for name in CHANNELS}
        denoised = upload(images["denoised"]) if "denoised" in images else None
        height, width = images["traced"].shape[:2]
        return Parents.of(arrays, (height, width), channels, denoised, expected)

    def images(self) -> dict[str, Image]:
        """Host images (h, w, C) of all parents that there are, by name."""
        planes = np.array(self.planes.values).reshape(-1, *self.shape)
        ends = np.cumsum(list(CHANNELS.values()))[:-1]
        found = dict(zip(CHANNELS, (np.moveaxis(of, 0, 2) for of in np.split(planes, ends)), strict=True))
        if self.denoised is not None:
            found["denoised"] = np.array(self.denoised).reshape(*self.shape, 3)
        return found

    @cached_property
    def grids(self) -> list[Grid]:
        """The pixels, and those of images half, a quarter and an eighth of the size."""
        return Grid.pyramid(self.arrays, *self.shape, 4)
