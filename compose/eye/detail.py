"""The detail that each part of a frame requires: level, sampling rate and cut-off; and what draws attention.

All vary slowly, so they are computed on a lattice, at the corners of cells of 16 x 16 pixels, and
interpolated in between. They, and the weights that follow from them, are continuous in the gaze: nothing
pops.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from scipy.ndimage import gaussian_filter, map_coordinates

from compose.eye.acuity import AcuityModel, Step, detail_steps
from compose.eye.display import Display
from compose.eye.gaze import Gaze
from compose.image.colour import Image, srgb_from_radiance

CELL = 16  # pixels, both sides of a cell
# (rows + 1, columns + 1) values at the corners of the cells that cover a frame.
Lattice = NDArray[np.float32]
# Fraction of an octave over which one step turns into the next. Over a whole octave two of them would be
# drawn nearly everywhere; without any they would pop. Where saliency affects the level, boundaries move
# faster than the gaze, and the second fraction applies.
_FADE, _FADE_BY_SALIENCY = 0.22, 0.25
# Gaussians show detail faithfully up to this fraction of the Nyquist frequency of their training pixels.
_FAITHFUL = 0.5
_NYQUIST = 0.5  # cycles per pixel
# How much more is resolved where the image draws attention (Fov-GS, Eq. 9).
_SALIENCY_GAIN = 0.4
# Width of the blur that joins the responses of one object, over the image's longer side (Hou et al. 2012).
_BLUR = 0.045


def corner_positions(width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x and y in pixels of the corners of a frame's cells, (rows + 1, columns + 1) each."""
    rows, columns = -(-height // CELL), -(-width // CELL)
    x, y = np.meshgrid(np.arange(columns + 1) * float(CELL), np.arange(rows + 1) * float(CELL))
    return x, y


def at_corners(image: NDArray[np.float32], width: int, height: int) -> Lattice:
    """A coarse image (h, w) of a frame at the corners of the frame's cells.

    It is interpolated bilinearly between its pixels' centres and constant beyond them.
    """
    x, y = corner_positions(width, height)
    position = [y / height * image.shape[0] - 0.5, x / width * image.shape[1] - 0.5]
    return map_coordinates(image, position, order=1, mode="nearest")


@dataclass(frozen=True)
class LayerRange:
    """The layers of a forest that may be drawn in a frame, from L, the finest, to `lowest`."""

    finest_frequency: float  # that layer L can show, in cycles per pixel of the frame
    finest_rates: tuple[int, ...]  # finest rate that is worth its samples, for each of layers 1 to L
    lowest: int = 1


@dataclass(frozen=True)
class DetailMap:
    """The detail that a frame requires, at the corners of its cells."""

    width: int  # of the frame, in pixels
    height: int
    layers: int  # L
    eccentricity: Lattice  # in degrees
    cutoff: Lattice  # highest frequency that is resolved, in cycles per pixel, at most 0.5
    # Highest frequency to keep. With Fov-GS's acuity model the cut-off (Eq. 8); with others all that the
    # samples carry: blurring further saves no time, and shows.
    low_pass: Lattice
    steps: tuple[Step, ...]  # what is drawn, from fine to coarse
    step_index: Lattice  # 0 for the first step; between two whole numbers both are blended
    # Continuous levels of detail: standard deviation in pixels that Gaussians may have; None with layers.
    levels: Lattice | None = None

    @property
    def drawn_level(self) -> Lattice:
        """Layer that is drawn, fractional where two are blended."""
        return self._interpolated([step.layer for step in self.steps])

    @property
    def drawn_rate(self) -> Lattice:
        """Rate that is drawn, fractional where two are blended."""
        return self._interpolated([step.rate for step in self.steps])

    def _interpolated(self, of_steps: list[int]) -> Lattice:
        return np.interp(self.step_index, np.arange(len(self.steps)), of_steps).astype(np.float32)

    def per_pixel(self, lattice: Lattice) -> NDArray[np.float32]:
        """(H, W) values of one of the map's lattices at the pixels' centres, interpolated bilinearly."""
        y, x = (np.arange(size) + 0.5 for size in (self.height, self.width))
        row, column = (y // CELL).astype(int), (x // CELL).astype(int)
        fy, fx = (y / CELL - row)[:, None], (x / CELL - column)[None, :]
        rows = lattice[row] * (1 - fy) + lattice[row + 1] * fy
        return (rows[:, column] * (1 - fx) + rows[:, column + 1] * fx).astype(np.float32)

    def weight(self, index: int) -> Lattice:
        """Weight of a step in the frame, 0..1; the weights of all steps sum to 1."""
        return np.maximum(1 - np.abs(self.step_index - np.float32(index)), 0)


def detail_map(
    display: Display,
    gaze: Gaze,
    width: int,
    height: int,
    acuity_model: AcuityModel,
    fov_b: float,
    layers: LayerRange,
    saliency: NDArray[np.float32] | None = None,
) -> DetailMap:
    """The detail that a viewer of a display resolves in a frame, shown around its centre, pixel by pixel.

    `fov_b` is the radius of the full-quality region in percent of the height; its edge is Fov-GS's e0.
    Saliency is (rows + 1, columns + 1) in 0..1 at the cells' corners.
    """
    per_degree, rays = _corners(display, width, height)
    radius, relative = fov_b / 100 * height, acuity_model.relative
    ray, edge = _gaze_ray_and_edge(display, gaze, width, height, radius)
    # Near zero an arc cosine loses half of its digits; what is left is more than float32 holds.
    angle = np.degrees(np.arccos(np.clip(rays @ ray, -1, 1)))
    # The full-quality region counts as its edge, where the periphery begins.
    cutoff = acuity_model.cutoff(np.maximum(angle, edge)) / per_degree
    deciding = cutoff
    if saliency is not None:
        cutoff = cutoff * (1 + _SALIENCY_GAIN * saliency.astype(np.float64))
        deciding = deciding if relative else cutoff
    straight = float(np.degrees(np.arctan(radius / display.focal)))
    # No coarser layer need show what layer L does not show faithfully.
    most = _NYQUIST if relative else min(_NYQUIST, _FAITHFUL * layers.finest_frequency)
    finest, ahead = (
        min(float(acuity_model.cutoff(np.array(e))) / display.pixels_per_degree, most)
        for e in (edge, straight)
    )
    fade = _FADE if relative else _FADE_BY_SALIENCY
    steps = detail_steps(finest, ahead, layers.finest_rates, layers.lowest, fade)
    with np.errstate(divide="ignore"):
        octaves = -np.log2(deciding)
    index = np.zeros_like(octaves)
    for step in steps[1:]:
        index += np.clip((octaves - step.octaves) / fade, 0, 1)
    resolved = np.minimum(cutoff, _NYQUIST).astype(np.float32)
    low_pass = resolved if relative else np.full_like(resolved, _NYQUIST)
    angle, index = angle.astype(np.float32), index.astype(np.float32)
    return DetailMap(width, height, len(layers.finest_rates), angle, resolved, low_pass, steps, index)


def resolved_share(
    display: Display, gaze: Gaze, width: int, height: int, acuity_model: AcuityModel
) -> NDArray[np.float32]:
    """(rows, columns) how much of what the pixels of each cell can hold a viewer resolves, 0..1.

    Of all frequencies up to that of the pixels, those up to the cut-off; args as in `detail_map`.
    """
    per_degree, rays = _corners(display, width, height)
    ray = display.viewer(width, height).rays(np.array([gaze.pixel(width, height)]))[0]
    angle = np.degrees(np.arccos(np.clip(rays @ ray, -1, 1)))
    share = np.square(np.minimum(acuity_model.cutoff(angle) / (per_degree * _NYQUIST), 1))
    return (0.25 * (share[1:, 1:] + share[1:, :-1] + share[:-1, 1:] + share[:-1, :-1])).astype(np.float32)


def _gaze_ray_and_edge(
    display: Display, gaze: Gaze, width: int, height: int, radius: float
) -> tuple[NDArray[np.float64], float]:
    """(3,) ray of the gaze, and the smallest angle in degrees from it to a circle of a radius in pixels."""
    viewer = display.viewer(width, height)
    position = np.array(gaze.pixel(width, height))
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = position + np.stack([np.cos(around), np.sin(around)], axis=1) * radius
    ray = viewer.rays(position[None])[0]
    return ray, float(np.degrees(np.arccos(min(1.0, (viewer.rays(circle) @ ray).max()))))


@lru_cache(maxsize=4)
def _corners(display: Display, width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels per degree (rows + 1, columns + 1) and rays (rows + 1, columns + 1, 3) at the cells' corners."""
    x, y = corner_positions(width, height)
    # Across the line of sight; along it pixels subtend an even smaller angle.
    per_degree = np.radians(1) * np.sqrt(display.focal**2 + (x - width / 2) ** 2 + (y - height / 2) ** 2)
    rays = display.viewer(width, height).rays(np.stack([x.ravel(), y.ravel()], axis=1))
    return per_degree, rays.reshape(*x.shape, 3)


def saliency(coarse: Image) -> NDArray[np.float32]:
    """(H, W) in 0..1 of a coarse image (H, W, 3) in linear radiance; about 64 pixels across suffice.

    The image signature (Hou, Harel and Koch 2012): the sign of the discrete cosine transform keeps what is
    sparse in the image and drops what is everywhere. It is taken of intensity and of two opponent channels;
    of intensity alone it would be blind to colour.
    """
    red, green, blue = np.moveaxis(srgb_from_radiance(coarse).astype(np.float64), -1, 0)
    channels = [(red + green + blue) / 3, red - green, blue - (red + green) / 2]
    response = np.zeros(red.shape)
    for channel in channels:
        reconstructed = idctn(np.sign(dctn(channel, norm="ortho")), norm="ortho")
        response += gaussian_filter(reconstructed**2, _BLUR * max(red.shape))
    low, high = response.min(), response.max()
    if high - low <= 1e-12 * max(high, 1e-30):
        return np.zeros(red.shape, dtype=np.float32)
    return ((response - low) / (high - low)).astype(np.float32)
