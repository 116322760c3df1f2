"""Pixels of posed images: linear radiance from sRGB, what is empty, and what moves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from compose.base.errors import UserError, one_line
from compose.base.limits import MOST_PIXELS
from compose.camera.camera import Camera
from compose.image.colour import Image, radiance_from_srgb
from pathtrace.posed.folder import PosedImage
from pathtrace.posed.lens import undistorted

# In labels that are masks of COLMAP, named ID.png.png, what is dark moves; in others, what is not zero does.
_COLMAP_SUFFIX = ".png.png"
_MODES = {"1", "L", "LA", "P", "RGB", "RGBA"}


@dataclass(frozen=True)
class PosedPixels:
    """What a posed image shows, without the distortion of its lens.

    Attributes:
        camera: the view; smaller than the image where a margin had to be cut off.
        radiance: (H, W, 3) float32, linear; over white where the image has alpha, as is convention.
        alpha: (H, W) float32 from 0 to 1, 0 where nothing is; None if the image is opaque.
        moving: (H, W) bool, what moves; None if nobody says.
    """

    camera: Camera
    radiance: Image
    alpha: NDArray[np.float32] | None
    moving: NDArray[np.bool_] | None


def read_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, from its header.

    Raises:
        UserError: it is missing, no image, or too large.
    """
    return _opened(path).size


def read_pixels(image: PosedImage) -> PosedPixels:
    """The pixels of a posed image.

    Raises:
        UserError: a file is missing, damaged, or its distortion is too strong to be undone.
    """
    planes = [_decoded(image.file, "RGBA")[..., channel] / 255.0 for channel in range(4)]
    if image.labels is not None:
        labels = _decoded(image.labels, "L")
        is_mask = image.labels.name.endswith(_COLMAP_SUFFIX)
        planes.append(np.asarray(labels < 128 if is_mask else labels > 0, dtype=np.float64))
    camera = image.camera
    if image.lens is not None:
        try:
            camera, planes = undistorted(camera, image.lens, planes)
        except ValueError as error:
            raise UserError(f"{image.file}: {error}") from error
    srgb, alpha = np.clip(np.stack(planes[:3], axis=-1), 0, 1), np.clip(planes[3], 0, 1)
    # Blended in sRGB, as those who publish such images do.
    radiance = radiance_from_srgb((srgb * alpha[..., None] + 1 - alpha[..., None]).astype(np.float32))
    return PosedPixels(
        camera,
        radiance,
        alpha.astype(np.float32) if (alpha < 1).any() else None,
        planes[4] >= 0.5 if image.labels is not None else None,
    )


def _decoded(path: Path, mode: str) -> NDArray[np.float64]:
    """Values from 0 to 255 of an image, (H, W) or (H, W, channels)."""
    with _opened(path) as image:
        try:
            return np.asarray(image.convert(mode), dtype=np.float64)
        except (OSError, SyntaxError, ValueError) as error:
            raise UserError(f"{path}: not a readable image ({one_line(error)})") from error


def _opened(path: Path) -> PillowImage.Image:
    """An image of which only the header has been read."""
    try:
        image = PillowImage.open(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: this image is missing") from error
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        raise UserError(f"{path}: not a readable image ({one_line(error)})") from error
    if image.mode not in _MODES or image.width * image.height > MOST_PIXELS:
        raise UserError(
            f"{path}: {image.width} x {image.height} pixels of {image.mode}; must have 8 bits per channel, "
            f"and at most {MOST_PIXELS:,} pixels"
        )
    return image
