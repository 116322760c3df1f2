"""The window's views of a frame in sRGB, late frames, and the path-traced frame that views compare with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import uploaded
from compose.camera.camera import Camera
from compose.fovea.warping import CELL, grid, warped
from compose.image.colour import Image, srgb_from_radiance
from compose.image.device_image import DeviceImage, srgb_bytes
from hybrid.base.compute_device import PassClock, device_arrays
from hybrid.measure.reference import REFERENCE_SEED
from hybrid.render.false_colours import levels_picture
from hybrid.render.frame import Frame
from hybrid.window.messages import ShownFrame, ShownView
from pathtrace.trace.film import FilmPositions, frame_positions, interleaved, pixel_positions
from pathtrace.trace.traced_images import TracedImage, auxiliary_images
from pathtrace.trace.tracer import Tracer, auxiliary_spp

if TYPE_CHECKING:
    from drjit.auto.ad import Float

# Each step traces one pixel of every 4 x 4 block: the window stays responsive, and the image sharpens
# everywhere at once. The order is that of a dither matrix (Bayer 1973).
_SIDE = 4
_ORDER = (0, 10, 2, 8, 5, 15, 7, 13, 1, 11, 3, 9, 4, 14, 6, 12)
# No screen shows a difference beyond this many samples per pixel.
_MOST_SAMPLES = 1024


class ConvergingFrame:
    """Path-traced radiance of one view, which gets better with every step, from a stand-in (H, W, 3)."""

    def __init__(self, tracer: Tracer, camera: Camera, stand_in: Image):
        self._tracer, self.camera = tracer, camera
        # One row per pixel, row-major: (H * W, 3) and (H * W,).
        self._stand_in = stand_in.reshape(-1, 3)
        self._sums = np.zeros_like(self._stand_in)
        self._counts = np.zeros(len(self._sums), dtype=np.float32)
        self._steps = 0

    @property
    def samples(self) -> int:
        """Samples that every pixel has."""
        return self._steps // len(_ORDER)

    @property
    def complete(self) -> bool:
        """Whether further samples would make no visible difference."""
        return self.samples >= _MOST_SAMPLES

    def refine(self) -> int:
        """Adds one sample to a sixteenth of the pixels, and returns how many paths those took."""
        # The pixels of this step have `samples` samples so far.
        samples, in_block = self.samples, _ORDER[self._steps % len(_ORDER)]
        # One of each block, row-major.
        rows = np.arange(in_block // _SIDE, self.camera.height, _SIDE, dtype=np.uint32)
        columns = np.arange(in_block % _SIDE, self.camera.width, _SIDE, dtype=np.uint32)
        pixels = (rows[:, None] * np.uint32(self.camera.width) + columns).ravel()
        self._steps += 1
        if not len(pixels):
            return 0
        positions = pixel_positions(mi.UInt32(pixels), self.camera.width)
        # Not the seeds of the frames that this one is compared with.
        seed = REFERENCE_SEED + self._steps
        traced = self._tracer.trace(self.camera, positions, 1, seed, samples, REFERENCE_SEED)
        self._sums[pixels] += interleaved(traced.radiance)
        self._counts[pixels] += 1
        return len(pixels)

    def image(self) -> Image:
        """(H, W, 3) mean radiance of all samples."""
        counts = self._counts[:, None]
        mean = np.where(counts > 0, self._sums / np.maximum(counts, 1), self._stand_in)
        return mean.reshape(self.camera.height, self.camera.width, 3)

    def denoised(self) -> Image:
        """(H, W, 3) the same, denoised: the noise of few samples would hide every difference."""
        return TracedImage(self.image(), *self._auxiliary).denoised(quick=True)

    @cached_property
    def _auxiliary(self) -> tuple[Image, Image]:
        """Albedo and normal, (H, W, 3) each."""
        positions = frame_positions(self.camera)
        return auxiliary_images(
            self._tracer, self.camera, positions, self.camera.width, auxiliary_spp(1), REFERENCE_SEED
        )


# Differences of this much in sRGB, or more, are white in the heat map.
_STRONGEST = 0.25


def image_of(view: ShownView, frame: Frame, path_traced: ConvergingFrame | None) -> NDArray[np.uint8]:
    """(H, W, 3) sRGB image of a view; ValueError if it needs the path-traced frame, and there is none."""
    if view is ShownView.LEVELS:
        return levels_picture(frame.composite, frame.detail, frame.region)
    if view is ShownView.FOVEA:
        return _srgb_bytes(frame.of_disc([c * frame.fovea.disc.weights for c in frame.fovea.radiance]))
    if not view.needs_path_traced:
        shown = frame.splats if view is ShownView.PERIPHERY else frame.image
        return srgb_bytes(shown.arrays, shown.flat(), (shown.height, shown.width, 3))
    if path_traced is None:
        raise ValueError(f"{view} needs the path-traced frame")
    if view is ShownView.DIFFERENCE:
        return _heat_map(frame.composite, path_traced.denoised())
    image = path_traced.image()
    if view is ShownView.PATH_TRACED:
        return _srgb_bytes(image)
    middle = image.shape[1] // 2
    split = _srgb_bytes(np.concatenate([frame.composite[:, :middle], image[:, middle:]], axis=1))
    # A white line between the two.
    split[:, middle] = 255
    return split


def _srgb_bytes(radiance: Image) -> NDArray[np.uint8]:
    """As compose.image.colour.bytes_from_radiance, in a kernel, which takes a tenth of the time."""
    arrays = device_arrays()
    return srgb_bytes(arrays, arrays.plain.Float(np.ascontiguousarray(radiance).ravel()), radiance.shape)


def _heat_map(image: Image, reference: Image) -> NDArray[np.uint8]:
    """Mean absolute difference in sRGB: black for none, then red, yellow, and white for the strongest."""
    difference = np.abs(srgb_from_radiance(image) - srgb_from_radiance(reference)).mean(axis=2)
    heat = 3 * np.clip(difference / _STRONGEST, 0, 1)[..., None] - np.arange(3)
    return (np.clip(heat, 0, 1) * 255 + 0.5).astype(np.uint8)


# Distance along each axis up to which two viewpoints are the same: all depths look alike then.
_SAME_VIEWPOINT = 1e-6
# Nothing is nearer, or an inverse depth would be infinite.
_NEAREST = 1e-6


def late_warped(shown: ShownFrame, newest: Camera, near: Callable[[Camera], Float]) -> ShownFrame:
    """A frame as the newest camera sees it, at the frame's size.

    `near` gives the inverse depth of what a camera sees in each cell of its `grid`, for `warped`; it is asked
    for only if the newest camera has not just turned. The frame is returned as it is if that camera is its
    own. The disc stays where it was traced. The time taken is that of a pass, "warp".
    """
    if newest == shown.request.settings.camera:
        return shown
    clock, arrays, camera = PassClock(), device_arrays(), shown.frame.camera
    newest = newest.resized(camera.width, camera.height)
    # To one that has only turned, all depths look alike.
    turned = np.allclose(camera.position, newest.position, rtol=0, atol=_SAME_VIEWPOINT)
    rows, columns = grid(camera)
    depths = dr.zeros(arrays.plain.Float, rows * columns) if turned else near(camera)
    plain, size = arrays.plain, (camera.width, camera.height)
    values = plain.Float(uploaded(plain.UInt8, shown.image))
    dr.eval(values)
    image = DeviceImage(arrays, values, *size, camera.width)
    flat = warped(image, depths, camera, newest).values
    pixels = np.asarray(plain.UInt8(flat + 0.5)).reshape(shown.image.shape)
    clock.lap("warp")
    return replace(shown, image=pixels, milliseconds=clock.milliseconds(shown.milliseconds))


def nearness(camera: Camera, tracer: Tracer) -> Float:
    """Inverse depth, 0 or more, of what a camera sees in each cell of its `grid`, by rays."""
    arrays, (rows, columns) = device_arrays(), grid(camera)
    plain = arrays.plain
    corner = pixel_positions(dr.arange(plain.UInt, rows * columns), columns)
    centres = FilmPositions((corner.x + 0.5) * CELL, (corner.y + 0.5) * CELL, 0.0, 0.0)
    dr.eval(centres.x, centres.y)
    position = tracer.auxiliary(camera, centres, 1, 0).position
    *axis, origin = arrays.scalars(plain.Float, camera.world_to_camera[2])
    depth = sum(plain.Float(at) * along for at, along in zip(position, axis, strict=True)) + origin
    return 1 / dr.maximum(depth, _NEAREST)
