"""False-colour pictures of a frame: its levels and sampling rates, and the parents of a fused fovea."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from compose.eye.acuity import COARSEST_RATE
from compose.eye.detail import DetailMap
from compose.fovea.cells import CellRegion
from compose.fovea.foveation import FoveaRegion
from compose.image.colour import Image, bytes_from_radiance
from hybrid.base.compute_device import device_arrays
from hybrid.render.frame import Frame

# Levels 1 to L run from red to blue.
_COARSE, _FINE = np.array([230.0, 70.0, 40.0]), np.array([40.0, 110.0, 240.0])
_TINT = 0.5  # share of the tint in the colour of a pixel
_RING = 10  # degrees between two rings
# Of compose.fusion.parents.PARENTS.
_OF_PARENTS = np.array([[255.0, 0, 0], [0, 255, 0], [120, 190, 255], [0, 0, 255]])


def detail_picture(frame: Image, detail: DetailMap, region: FoveaRegion | CellRegion) -> NDArray[np.uint8]:
    """(H + legend, W, 3) sRGB: `levels_picture` above a legend of its colours and lines."""
    return np.vstack([levels_picture(frame, detail, region), _legend(detail)])


def levels_picture(frame: Image, detail: DetailMap, region: FoveaRegion | CellRegion) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB: the frame in grey, tinted by level, with lines between rates and rings of angle.

    Below the full rate, the frame, linear radiance (H, W, 3), is shown in blocks as large as its samples.
    White rings mark every 10 degrees of eccentricity, black lines separate sampling rates. Pixels that show
    the path tracer alone keep their colours.
    """
    picture = bytes_from_radiance(frame).astype(np.float64)
    rate = _rates(detail)
    for step in range(1, COARSEST_RATE + 1):
        picture = np.where((rate == step)[..., None], _in_blocks(picture, 1 << step), picture)
    share = ((detail.per_pixel(detail.drawn_level) - 1) / max(detail.layers - 1, 1))[..., None]
    tint = _COARSE * (1 - share) + _FINE * share
    grey = picture.mean(axis=2, keepdims=True)
    tinted = (1 - _TINT) * grey + _TINT * tint * (0.4 + 0.6 * grey / 255)
    traced = region.disc(device_arrays())
    picture = np.where(traced.frame_image([traced.weights]) >= 1, picture, tinted)
    picture[_borders(np.floor(detail.per_pixel(detail.eccentricity) / _RING))] = 255
    for step in range(1, COARSEST_RATE + 1):
        picture[_borders(rate >= step)] = 0
    return picture.astype(np.uint8)


def _borders(values: NDArray[Any]) -> NDArray[np.bool_]:
    """(H, W) where values differ from those to the left or above."""
    found = np.zeros(values.shape, dtype=bool)
    found[:, 1:] |= values[:, 1:] != values[:, :-1]
    found[1:] |= values[1:] != values[:-1]
    return found


def _rates(detail: DetailMap) -> NDArray[np.int64]:
    """(H, W) sampling rate, the one with the larger share where two are blended."""
    return np.rint(detail.per_pixel(detail.drawn_rate)).astype(np.int64)


def _in_blocks(picture: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """(H, W, 3) in which each block of size x size pixels has its mean."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((0, -height % size), (0, -width % size), (0, 0)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // size, size, padded.shape[1] // size, size, 3).mean(axis=(1, 3))
    return blocks.repeat(size, axis=0).repeat(size, axis=1)[:height, :width]


def _legend(detail: DetailMap) -> NDArray[np.uint8]:
    """(legend, W, 3) sRGB."""
    size = max(12, detail.width // 80)
    strip = Pillow.new("RGB", (detail.width, 3 * size), "white")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(size)
    x = size // 2
    for layer in range(1, detail.layers + 1):
        share = (layer - 1) / max(detail.layers - 1, 1)
        colour = tuple(int(c) for c in _COARSE * (1 - share) + _FINE * share)
        draw.rectangle((x, size // 2, x + size, size // 2 + size), fill=colour)
        draw.text((x + 1.3 * size, size // 2), f"layer {layer}", "black", font)
        x += int(1.3 * size + draw.textlength("layer 0  ", font))
    present = ", ".join(f"{1 << step} x {1 << step}" for step in sorted(set(_rates(detail).ravel().tolist())))
    rings = f"white: every {_RING} degrees from the gaze"
    text = f"{rings}   black: between rates (one sample per {present} pixels)"
    draw.text((size // 2, 1.7 * size), text, "black", font)
    return np.asarray(strip)


def weights_picture(frame: Frame) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB: the shares of traced, denoised, relit and splat as red, green, light blue and blue.

    Outside the disc, the picture shows the frame itself in dark grey. ValueError if the fovea is not fused.
    """
    if frame.fovea.weights is None:
        raise ValueError("only a fused fovea has weights")
    shown = bytes_from_radiance(frame.composite).mean(axis=2, keepdims=True).repeat(3, axis=2) * 0.4
    inside = np.asarray(frame.fovea.disc.pixels)
    shares = frame.of_disc(frame.fovea.weights).reshape(-1, len(_OF_PARENTS))[inside]
    shown.reshape(-1, 3)[inside] = shares @ _OF_PARENTS
    return (np.clip(shown, 0, 255) + 0.5).astype(np.uint8)
