"""Frames of a scene as it was before a change: what still holds of them, and what is traced anew.

A scene that was changed and loaded again does not say what is different in it. Its frames do: a small picture
of each view as it is now, a sixteenth of the pixels, is compared with the frame tile by tile.
"""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from compose.camera.camera import Camera
from compose.image.colour import Image, srgb_from_radiance
from pathtrace.dataset.captured_frames import CapturedFrame, geometry_of
from pathtrace.trace.film import frame_positions
from pathtrace.trace.traced_images import TracedImage, denoise, trace_frame
from pathtrace.trace.tracer import Tracer

# Sides in pixels of a tile, and of what becomes a pixel of the small picture.
TILE, _COARSER = 16, 4
# Samples in a pixel of the small picture.
_SPP = 24
# Mean differences from which a tile has changed: of light in sRGB values, of albedo, and of the parts of
# normals. Where nothing has, noise leaves half as much of the first.
_LIGHT, _ALBEDO, _NORMAL = 0.03, 0.03, 0.06
# Differences of depths in units of the depth, and the pixels of a tile in which they matter.
_DEPTH, _PIXELS = 1e-3, 2
# Pixels around what changed that are denoised with it.
_MARGIN = 32

Bits = NDArray[np.bool_]


@dataclass(frozen=True)
class SeenAgain:
    """A view of before as it is now: its depth, unfolded distance and shape, and what has changed of it."""

    camera: Camera
    geometry: tuple[Image, Image, NDArray[np.int32]]  # of `geometry_of`
    tiles: Bits  # (H / TILE, W / TILE), those that have changed

    @property
    def pixels(self) -> Bits:
        """(H, W) pixels of the tiles that have changed."""
        return np.repeat(np.repeat(self.tiles, TILE, axis=0), TILE, axis=1)

    def traced(self, tracer: Tracer, half: TracedImage, spp: int, seed: int) -> TracedImage:
        """Samples of before, with new ones in the changed tiles."""
        chosen = np.flatnonzero(self.pixels).astype(np.uint32)
        positions = frame_positions(self.camera).taken(mi.UInt32(chosen))
        traced, features = tracer.trace_with_features(self.camera, positions, spp, seed)
        found = []
        for image, new in zip(
            vars(half).values(), (traced.radiance, features.albedo, features.normal), strict=True
        ):
            image = image.copy()
            image.reshape(-1, 3)[chosen] = np.stack([channel.numpy() for channel in new], axis=1)
            found.append(image)
        return TracedImage(*found)

    def framed(self, before: Image, traced: TracedImage) -> CapturedFrame:
        """The denoised frame, of which what has not changed is as before, (H, W, 3)."""
        rows, columns = (np.flatnonzero(self.pixels.any(axis=axis)) for axis in (1, 0))
        box = tuple(slice(max(0, at[0] - _MARGIN), at[-1] + 1 + _MARGIN) for at in (rows, columns))
        radiance, changed = before.copy(), self.pixels[box]
        new = denoise(*(image[box] for image in vars(traced).values()))
        radiance[box][changed] = new[changed]
        return CapturedFrame(radiance, traced.albedo, traced.normal, *self.geometry)


def can_be_seen_again(camera: Camera) -> bool:
    """Whether a view consists of whole tiles."""
    return not (camera.width % TILE or camera.height % TILE)


def seen_again(tracer: Tracer, camera: Camera, frame: CapturedFrame, seed: int) -> SeenAgain:
    """What has changed of a captured frame, which consists of whole tiles."""
    small = camera.resized(camera.width // _COARSER, camera.height // _COARSER)
    now, geometry = trace_frame(tracer, small, _SPP, seed), geometry_of(tracer, camera)
    light = srgb_from_radiance(_means(frame.radiance, _COARSER)) - srgb_from_radiance(now.denoised())
    side = TILE // _COARSER
    changed = (np.abs(_means(light, side)) > _LIGHT).any(axis=2)
    for before, after, most in ((frame.albedo, now.albedo, _ALBEDO), (frame.normal, now.normal, _NORMAL)):
        difference = np.abs(_means(_means(before, _COARSER) - after, 2))
        changed |= (_means(difference, side // 2) > most).any(axis=2)
    with np.errstate(invalid="ignore"):
        # Where nothing is hit now and before, the difference is not a number.
        moved = np.abs(geometry[0] - frame.depth) > _DEPTH * np.minimum(geometry[0], frame.depth)
    changed |= _means(moved[..., None].astype(np.float32), TILE)[..., 0] >= _PIXELS / TILE**2
    return SeenAgain(camera, geometry, binary_dilation(changed) if changed.any() else changed)


def _means(image: NDArray[np.floating], side: int) -> NDArray[np.floating]:
    """Means over squares of an image (H, W, C)."""
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean(axis=(1, 3))
