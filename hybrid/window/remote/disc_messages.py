"""Messages about the path-traced disc that a server streams, beside those of `protocol`."""

from __future__ import annotations

import struct
import time
import zlib
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compose.base.errors import UserError
from compose.camera.camera import Camera
from compose.eye.gaze import Gaze
from compose.fovea.foveation import Foveation
from compose.fovea.warping import grid
from compose.image.colour import radiance_from_srgb
from hybrid.render.frame_settings import MOST_SPP
from hybrid.render.image_files import image_of_jpeg, jpeg_bytes

DISC_WANTED, DISC = 5, 6
_WANTED = struct.Struct("<BddI")
_DISC = struct.Struct("<BIiiHddf?fI")
_NUMBERS = "sequence", "left", "top", "side", "fov_a", "fov_b", "spp", "final", "greatest"
# Pixels of a disc's square: that of a radius of 15 % in a frame of 4K, and a fifth more.
MOST_PIXELS = 1 << 19
# Of JPEG, while the view changes and when the disc has its last samples: at 85 it would be 2 dB worse than
# what was rendered (`room`, single samples). Colour keeps its resolution: where people look, they resolve
# nearly as much of it as of luminance (89 of 94 pixels per degree, red and green; Ashraf et al. 2025).
_QUALITY, _FINAL_QUALITY = 95, 98
# Pixels by which a square may lie beside the frame's origin, and inverse depth of the nearest things.
_FURTHEST, _NEAREST = 1 << 24, 1e6
# Steps of inverse depths, of which the greatest is given as it is.
_STEPS = 255
# Linear radiance of sRGB bytes.
_LINEAR = radiance_from_srgb(np.arange(256) / 255).astype(np.float32)


@dataclass(frozen=True)
class DiscWanted:
    """That a client wants a disc: `fov_a`, `fov_b` and `spp` of `FrameSettings`."""

    fov_a: float
    fov_b: float
    spp: int

    def packed(self) -> bytes:
        """The message."""
        return _WANTED.pack(DISC_WANTED, self.fov_a, self.fov_b, self.spp)

    @staticmethod
    def unpacked(message: bytes) -> DiscWanted:
        """Reads a message; ValueError if anything in it is out of range."""
        if len(message) != _WANTED.size:
            raise ValueError(f"a wanted disc of {len(message)} bytes; must have {_WANTED.size}")
        _, fov_a, fov_b, spp = _WANTED.unpack(message)
        _require_radii(fov_a, fov_b)
        if not 1 <= spp <= MOST_SPP:
            raise ValueError(f"a disc of {spp} samples per pixel; must be 1 to {MOST_SPP}")
        return DiscWanted(fov_a, fov_b, spp)


@dataclass(frozen=True)
class DiscMessage:
    """The path-traced disc of a view, in the square around it.

    Attributes:
        sequence: of the view.
        left, top, side: of the square in pixels of the view's frame, beyond which it may lie; a side of 0 for
            no disc.
        fov_a, fov_b: radii of the blend in percent of the frame's height, at most those that are wanted.
        spp: samples per pixel, on average.
        final: whether no better one follows for this view.
        greatest: inverse depth that 255 stands for, in units of the scene.
        depths: deflated bytes of inverse depths, one for each cell of the square's `grid`.
        picture: JPEG.
    """

    sequence: int
    left: int = 0
    top: int = 0
    side: int = 0
    fov_a: float = 0.0
    fov_b: float = 0.0
    spp: float = 0.0
    final: bool = True
    greatest: float = 0.0
    depths: bytes = b""
    picture: bytes = b""

    def packed(self) -> bytes:
        """The message."""
        numbers = (getattr(self, name) for name in _NUMBERS)
        return _DISC.pack(DISC, *numbers, len(self.depths)) + self.depths + self.picture

    @staticmethod
    def unpacked(message: bytes) -> DiscMessage:
        """Reads a message; ValueError if anything but its depths and its picture is out of range."""
        if len(message) < _DISC.size:
            raise ValueError(f"a disc of {len(message)} bytes")
        _, *numbers, count = _DISC.unpack_from(message)
        end = _DISC.size + count
        head = DiscMessage(**dict(zip(_NUMBERS, numbers, strict=True)))
        found = replace(head, depths=message[_DISC.size : end], picture=message[end:])
        if found.side**2 > MOST_PIXELS:
            raise ValueError(f"a disc in {found.side} x {found.side} pixels; at most {MOST_PIXELS} are taken")
        _require_radii(found.fov_a, found.fov_b)
        is_near = max(abs(found.left), abs(found.top)) <= _FURTHEST
        if not (is_near and 0 <= found.spp < np.inf and 0 <= found.greatest <= _NEAREST):
            raise ValueError("a disc with numbers out of range")
        return found


def content_of(image: NDArray[np.uint8], nearness: NDArray[np.float32], final: bool) -> dict[str, Any]:
    """`greatest`, `depths` and `picture` of a message.

    The image is (side, side, 3) sRGB; `nearness` (rows * columns,) the inverse depth in each cell of the
    square's `grid`.
    """
    greatest = float(nearness.max())
    steps = nearness * (_STEPS / greatest if greatest > 0 else 0.0)
    depths = zlib.compress(np.uint8(steps + 0.5).tobytes())
    picture = jpeg_bytes(image, _FINAL_QUALITY if final else _QUALITY)
    return {"greatest": greatest, "depths": depths, "picture": picture}


@dataclass(frozen=True)
class StreamedDisc:
    """A disc as a client has it.

    Attributes:
        message: what it was read from.
        camera, gaze: of the view that it was traced for.
        image: (side, side, 3) sRGB.
        nearness: (rows * columns,) inverse depth in each cell of the square's `grid`.
        came: time.monotonic of when it was read.
    """

    message: DiscMessage
    camera: Camera
    gaze: Gaze
    image: NDArray[np.uint8]
    nearness: NDArray[np.float32]
    came: float = field(default_factory=time.monotonic)

    @cached_property
    def radiance(self) -> NDArray[np.float32]:
        """(side, side, 3) the image in linear radiance."""
        return _LINEAR[self.image]

    @property
    def square(self) -> Camera:
        """The camera that sees the disc's square."""
        message = self.message
        return self.camera.cropped(message.left, message.top, message.side, message.side)

    @staticmethod
    def of(message: DiscMessage, camera: Camera, gaze: Gaze) -> StreamedDisc:
        """Reads depths and picture, in no more memory than those take; ValueError if they do not fit."""
        side = message.side
        rows, columns = grid(camera.cropped(0, 0, side, side))
        inflating = zlib.decompressobj()
        try:
            steps = inflating.decompress(message.depths, rows * columns)
        except zlib.error as error:
            raise ValueError(f"depths that cannot be inflated ({error})") from error
        if len(steps) != rows * columns:
            raise ValueError(f"{len(steps)} depths, not {rows} x {columns}")
        nearness = np.frombuffer(steps, np.uint8) * np.float32(message.greatest / _STEPS)
        image = image_of_jpeg(message.picture, side, side)
        return StreamedDisc(message, camera, gaze, image, nearness)


def _require_radii(fov_a: float, fov_b: float) -> None:
    try:
        Foveation(Gaze(), fov_a, fov_b)
    except UserError as error:
        raise ValueError(str(error)) from error
