"""Frames of a scene as it was before a change: what still holds of them, and what is traced anew.

A scene that was changed and loaded again does not say what is different in it. Its frames do: a small picture
of each view as it is now is compared with the frame, tile by tile.
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

# Pixels of the small picture along the shorter side of a view, at most, and along the side of a tile.
_SMALL, _OF_A_TILE = 64, 4
# Samples in a pixel of it.
_SPP = 24
# Mean differences from which a tile has changed: of light in sRGB values, of albedo, and of the parts of
# normals. Where nothing has, noise leaves half as much of the first.
_LIGHT, _ALBEDO, _NORMAL = 0.03, 0.03, 0.06
# Differences of depths in units of the depth, and the share of a tile in which they matter.
_DEPTH, _SHARE = 1e-3, 0.1
# Pixels around what changed that are denoised with it.
_MARGIN = 32

Bits = NDArray[np.bool_]


@dataclass(frozen=True)
class SeenAgain:
    """A view of before as it is now.

    Attributes:
        tiles: (rows, columns) which of its tiles have changed.
        side: of a tile, in pixels.
        share: of tiles with a surface or a change, those that have changed; 0 if there are none.
    """

    camera: Camera
    tiles: Bits
    side: int
    share: float

    @property
    def pixels(self) -> Bits:
        """(H, W) pixels of the tiles that have changed."""
        return np.repeat(np.repeat(self.tiles, self.side, axis=0), self.side, axis=1)

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

    def framed(self, tracer: Tracer, before: Image, traced: TracedImage) -> CapturedFrame:
        """The denoised frame, of whose radiance what has not changed is as before, (H, W, 3)."""
        rows, columns = (np.flatnonzero(self.pixels.any(axis=axis)) for axis in (1, 0))
        box = tuple(slice(max(0, at[0] - _MARGIN), at[-1] + 1 + _MARGIN) for at in (rows, columns))
        radiance, changed = before.copy(), self.pixels[box]
        new = denoise(*(image[box] for image in vars(traced).values()))
        radiance[box][changed] = new[changed]
        return CapturedFrame(radiance, traced.albedo, traced.normal, *geometry_of(tracer, self.camera))


def can_be_seen_again(camera: Camera) -> bool:
    """Whether a view consists of whole tiles."""
    side = _OF_A_TILE * _coarser(camera)
    return not (camera.width % side or camera.height % side)


def seen_again(tracer: Tracer, camera: Camera, frame: CapturedFrame, seed: int) -> SeenAgain:
    """What has changed of a captured frame, which consists of whole tiles."""
    coarser = _coarser(camera)
    small = camera.resized(camera.width // coarser, camera.height // coarser)
    now = trace_frame(tracer, small, _SPP, seed)
    light = srgb_from_radiance(_means(frame.radiance, coarser)) - srgb_from_radiance(now.denoised())
    changed = (np.abs(_means(light, _OF_A_TILE)) > _LIGHT).any(axis=2)
    for before, after, most in ((frame.albedo, now.albedo, _ALBEDO), (frame.normal, now.normal, _NORMAL)):
        # Details of half a tile: finer ones are noise.
        difference = np.abs(_means(_means(before, coarser) - after, _OF_A_TILE // 2))
        changed |= (_means(difference, 2) > most).any(axis=2)
    moved = _means(_moved(tracer, camera, frame.depth, coarser)[..., None], _OF_A_TILE)[..., 0]
    changed |= moved > _SHARE
    tiles = binary_dilation(changed) if changed.any() else changed
    side = _OF_A_TILE * coarser
    asked = tiles | (_means(np.isfinite(frame.depth)[..., None], side)[..., 0] > 0)
    return SeenAgain(camera, tiles, side, tiles.sum() / max(asked.sum(), 1))


def _coarser(camera: Camera) -> int:
    """Pixels of a view along the side of a pixel of the small picture."""
    return max(1, min(camera.width, camera.height) // _SMALL)


def _moved(tracer: Tracer, camera: Camera, depth: Image, coarser: int) -> Bits:
    """Which pixels have another depth than before, (H, W): one of each square of so many along its side."""
    x, y = np.meshgrid(*(np.arange(coarser // 2, side, coarser) for side in (camera.width, camera.height)))
    index = mi.UInt32((y * camera.width + x).ravel().astype(np.uint32))
    distance = tracer.hits(camera, frame_positions(camera).taken(index)).distance
    rays = camera.rays(np.stack([x.ravel() + 0.5, y.ravel() + 0.5], axis=1))
    now, before = (distance * (rays @ camera.camera_to_world[:3, 2])).reshape(x.shape), depth[y, x]
    with np.errstate(invalid="ignore"):
        # Where nothing is hit now and before, the difference is not a number.
        return np.abs(now - before) > _DEPTH * np.minimum(now, before)


def _means(image: NDArray[np.floating] | Bits, side: int) -> NDArray[np.floating]:
    """Means over squares of an image (H, W, C)."""
    height, width, channels = image.shape
    return image.reshape(height // side, side, width // side, side, channels).mean(axis=(1, 3))
