"""A picture to look at: level, sampling rate and eccentricity of a frame, per pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from compose.eye.detail import DetailMap
from compose.eye.steps import COARSEST_RATE
from compose.fovea.region import FoveaRegion
from compose.image.colour import Image, bytes_from_radiance

# Level 1 to L from red to blue; what is in between is mixed.
_COARSE, _FINE = np.array([230.0, 70.0, 40.0]), np.array([40.0, 110.0, 240.0])
_TINT = 0.5
_RING = 10  # degrees between two rings


def detail_picture(frame: Image, detail: DetailMap, region: FoveaRegion) -> NDArray[np.uint8]:
    """(H + legend, W, 3) sRGB: `levels_picture` above a strip that says what its colours and lines mean."""
    return np.vstack([levels_picture(frame, detail, region), _legend(detail)])


def levels_picture(frame: Image, detail: DetailMap, region: FoveaRegion) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB: the frame in grey, tinted by level, with tiles by rate and rings by angle.

    Below full rate the frame is shown in blocks as large as its samples; white rings stand at every 10
    degrees of eccentricity, black lines between rates; what is path-traced alone keeps its colours.
    """
    picture = bytes_from_radiance(frame).astype(np.float64)
    rate = _rates(detail)
    for step in range(1, COARSEST_RATE + 1):
        picture = np.where((rate == step)[..., None], _in_blocks(picture, 1 << step), picture)
    share = ((detail.per_pixel(detail.drawn_level) - 1) / max(detail.layers - 1, 1))[..., None]
    tint = _COARSE * (1 - share) + _FINE * share
    grey = picture.mean(axis=2, keepdims=True)
    tinted = (1 - _TINT) * grey + _TINT * tint * (0.4 + 0.6 * grey / 255)
    picture = np.where((region.weight_image() >= 1)[..., None], picture, tinted)
    angle = detail.per_pixel(detail.eccentricity)
    ring = np.floor(angle / _RING)
    edge = np.zeros(ring.shape, dtype=bool)
    edge[:, 1:] |= ring[:, 1:] != ring[:, :-1]
    edge[1:] |= ring[1:] != ring[:-1]
    picture[edge] = 255
    for step in range(1, COARSEST_RATE + 1):
        border = np.zeros(rate.shape, dtype=bool)
        border[:, 1:] |= (rate[:, 1:] >= step) != (rate[:, :-1] >= step)
        border[1:] |= (rate[1:] >= step) != (rate[:-1] >= step)
        picture[border] = 0
    return picture.astype(np.uint8)


def _rates(detail: DetailMap) -> NDArray[np.int64]:
    """(H, W) the rate that has the larger share."""
    return np.rint(detail.per_pixel(detail.drawn_rate)).astype(np.int64)


def _in_blocks(picture: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((0, -height % size), (0, -width % size), (0, 0)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // size, size, padded.shape[1] // size, size, 3).mean(axis=(1, 3))
    return blocks.repeat(size, axis=0).repeat(size, axis=1)[:height, :width]


def _legend(detail: DetailMap) -> NDArray[np.uint8]:
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
    text = (
        f"white: every {_RING} degrees from the gaze   black: between rates (one sample per {present} pixels)"
    )
    draw.text((size // 2, 1.7 * size), text, "black", font)
    return np.asarray(strip)
