"""Third-party images with known cameras and times: their folder, their lens, and their pixels without it.

The model of the lens is that of Nerfies' cameras, and of OpenCV: radial coefficients, two tangential ones,
and skew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy.ndimage import map_coordinates

from compose.base.errors import MOST_PIXELS, UserError, one_line
from compose.camera.camera import Array, Camera
from compose.image.colour import Image, radiance_from_srgb

# Share of a frame's pixels that must be left once what the lens did not show is cut off.
_LEAST_LEFT = 0.5
# Pixels beyond the border that are taken for the border itself.
_TOLERANCE = 0.5
# In labels that are masks of COLMAP, named ID.png.png, what is dark moves; in others, what is not zero does.
_COLMAP_SUFFIX = ".png.png"
# Of more images than this, each n-th is held out if nobody says which, as is convention.
HELD_OUT_EVERY = 8
# Where a PNG file says how many bits each channel has.
_BITS_AT = 24
_MODES = {"1", "L", "LA", "P", "RGB", "RGBA"}


@dataclass(frozen=True)
class Lens:
    """How a lens distorts."""

    radial: tuple[float, float, float] = (0.0, 0.0, 0.0)  # k1, k2, k3
    tangential: tuple[float, float] = (0.0, 0.0)  # p1, p2
    skew: float = 0.0  # pixels to the right per unit downwards on the image plane
    # k4, k5 and k6 of OpenCV, by which the radial part is divided.
    divisor: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where points of the image plane at depth 1 appear on it."""
        (k1, k2, k3), (k4, k5, k6), (p1, p2) = self.radial, self.divisor, self.tangential
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
        )


def undistorted(camera: Camera, lens: Lens, images: Sequence[Array]) -> tuple[Camera, list[Array]]:
    """Images (H, W) as a camera without a lens shows them, cut to what the lens showed, and that camera.

    They are resampled by cubic splines; `camera` is the view without distortion, at their size. ValueError if
    the distortion is too strong: it folds, or leaves less than half of the frame.
    """
    centres, shape = camera.pixel_centres(), (camera.height, camera.width)
    # Lenses of damaged files overflow, and are refused.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        x, y = lens.distorted(
            (centres[:, 0] - camera.cx) / camera.fx, (centres[:, 1] - camera.cy) / camera.fy
        )
        # Columns and rows, counted from 0, where the image shows what a pixel does.
        x, y = camera.fx * x + lens.skew * y + camera.cx - 0.5, camera.fy * y + camera.cy - 0.5
        x, y = x.reshape(shape), y.reshape(shape)
        rows, columns = _valid_rectangle(camera, x, y)
    at = np.stack([y[rows, columns], x[rows, columns]])
    _, height, width = at.shape
    if height * width < _LEAST_LEFT * x.size or _folds(at[1], at[0]):
        raise ValueError(
            f"distortion {[*lens.radial, *lens.tangential, *lens.divisor]} is too strong for an image of "
            f"{camera.width} x {camera.height} pixels; undistort the images first"
        )
    cut = camera.cropped(columns.start, rows.start, width, height)
    return cut, [map_coordinates(image, at, order=3, mode="nearest") for image in images]


def _valid_rectangle(camera: Camera, x: Array, y: Array) -> tuple[slice, slice]:
    """Rows and columns left when sides that the image does not show are cut off, the worst one first."""
    across, down = (
        np.abs(2 * at - (size - 1)) <= size - 1 + 2 * _TOLERANCE
        for at, size in ((x, camera.width), (y, camera.height))
    )
    # What is not a number is not shown, either.
    missed = ~(across & down)
    top, bottom, left, right = 0, camera.height, 0, camera.width
    while top < bottom and left < right and missed[top:bottom, left:right].any():
        inner = missed[top:bottom, left:right]
        shares = [side.mean() for side in (inner[0], inner[-1], inner[:, 0], inner[:, -1])]
        worst = int(np.argmax(shares))
        # A hole amid the frame is no margin: cutting goes on until little is left, which is refused.
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)


def _folds(x: Array, y: Array) -> bool:
    """Whether neighbours change places somewhere."""
    if min(x.shape) < 2:
        return False
    (x_down, x_across), (y_down, y_across) = np.gradient(x), np.gradient(y)
    return bool((x_across * y_down <= x_down * y_across).any())


@dataclass(frozen=True)
class PosedImage:
    """An image of a known camera and time."""

    camera: Camera  # the view without the distortion of its lens, in the size of the image
    lens: Lens | None  # its distortion; None if there is none
    file: Path  # the image, PNG or JPEG in sRGB, with or without alpha
    labels: Path | None  # an image of the same size that shows what moves; None if nobody says
    time: float  # that it shows, from 0 to 1
    held_out: bool  # whether training must not see it


@dataclass(frozen=True)
class PosedFolder:
    """A folder of posed images."""

    folder: Path
    layout: str  # its name
    scene_name: str  # the folder's name, as far as it can be that of a scene
    scene_hash: str  # SHA-256 of the images and of all that is known of them
    images: list[PosedImage]  # training and held-out ones, in the order of the folder
    # (M, 3) float64, some of what the images show, in world space; None if none are known.
    points: NDArray[np.float64] | None = None
    # Distances between which everything lies that they show; None if nobody says.
    bounds: tuple[float, float] | None = None

    @property
    def digest(self) -> str:
        """What distinguishes it from other folders."""
        return self.scene_hash

    @property
    def training(self) -> list[PosedImage]:
        """Images to train on."""
        return [image for image in self.images if not image.held_out]

    @property
    def held_out(self) -> list[PosedImage]:
        """Images that training must not see."""
        return [image for image in self.images if image.held_out]

    @property
    def moves(self) -> bool:
        """Whether the training images show several times."""
        return len({image.time for image in self.training}) > 1


@dataclass(frozen=True)
class PosedPixels:
    """What a posed image shows, without the distortion of its lens."""

    camera: Camera  # the view; smaller than the image where a margin had to be cut off
    radiance: Image  # (H, W, 3) float32, linear; over white where the image has alpha, as is convention
    # (H, W) float32 from 0 to 1, 0 where nothing is; None if the image is opaque.
    alpha: NDArray[np.float32] | None
    moving: NDArray[np.bool_] | None  # (H, W) bool, what moves; None if nobody says


def read_size(path: Path) -> tuple[int, int]:
    """Width and height of an image, from its header; UserError if it is missing, no image, or too large."""
    return _opened(path).size


def read_pixels(image: PosedImage) -> PosedPixels:
    """The pixels of a posed image; UserError if a file is missing or damaged, or too distorted."""
    planes = list(np.moveaxis(_decoded(image.file), -1, 0))
    if image.labels is not None:
        labels = _decoded(image.labels)[..., :3].mean(axis=-1)
        is_mask = image.labels.name.endswith(_COLMAP_SUFFIX)
        planes.append(np.asarray(labels < 0.5 if is_mask else labels > 0, dtype=np.float64))
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


def _decoded(path: Path) -> NDArray[np.float64]:
    """(H, W, 4) red, green, blue and alpha of an image, from 0 to 1."""
    with _opened(path) as image:
        try:
            if not _is_deep(path, image):
                return np.asarray(image.convert("RGBA"), dtype=np.float64) / 255
            # Pillow reduces most of these to 8 bits; its checksums are tried first.
            image.load()
            values = np.atleast_3d(np.array(mi.Bitmap(str(path)), dtype=np.float64)) / 65535
        except (OSError, SyntaxError, ValueError, RuntimeError) as error:
            raise UserError(f"{path}: not a readable image ({one_line(error)})") from error
    colours, alpha = (values[..., :3], values[..., 3:]) if values.shape[2] > 2 else np.split(values, [1], 2)
    shape = *values.shape[:2], 3
    return np.dstack([np.broadcast_to(colours, shape), alpha if alpha.size else np.ones(shape[:2])])


def _is_deep(path: Path, image: PillowImage.Image) -> bool:
    """Whether an image is a PNG file with 16 bits per channel."""
    if image.format != "PNG":
        return False
    with path.open("rb") as file:
        return file.read(_BITS_AT + 1)[-1] == 16


def _opened(path: Path) -> PillowImage.Image:
    """An image of which only the header has been read."""
    try:
        image = PillowImage.open(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: this image is missing") from error
    except (OSError, SyntaxError, ValueError, PillowImage.DecompressionBombError) as error:
        raise UserError(f"{path}: not a readable image ({one_line(error)})") from error
    if (image.mode not in _MODES and not _is_deep(path, image)) or image.width * image.height > MOST_PIXELS:
        raise UserError(
            f"{path}: {image.width} x {image.height} pixels of {image.mode}; must have 8 bits per channel, "
            f"or 16 in a PNG file, and at most {MOST_PIXELS:,} pixels"
        )
    return image
