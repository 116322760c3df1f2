"""How much detail a frame needs where: level, sampling rate and cut-off, on a lattice of points.

All three vary slowly, so they are computed at the corners of cells of 16 x 16 pixels and interpolated in
between. They, and the weights that follow from them, are continuous in the gaze: nothing pops.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from compose.acuity import Law, continuous_level, with_saliency
from compose.view import Display, Gaze, eccentricity_at

CELL = 16  # pixels
COARSEST_RATE = 3  # log2 of pixels per sample along each axis
# Share of an octave over which one layer, or one rate, turns into the next. Over a whole octave two of
# them would be drawn nearly everywhere; a step would pop.
_FADE = 0.25
# Gaussians trained on pixels show detail of up to this share of the pixels' Nyquist frequency as it is.
_FAITHFUL = 0.5
Lattice = NDArray[np.float32]


@dataclass(frozen=True)
class DetailMap:
    """What a frame needs, at the corners of its cells.

    Attributes:
        width, height: frame in pixels.
        lowest: the coarsest layer that may be drawn.
        finest_rates: of layers 1 to L, the finest rate that is worth its samples; a rate is the log2 of the
            pixels per sample along each axis.
        eccentricity: (rows + 1, columns + 1) in degrees.
        cutoff: (rows + 1, columns + 1) highest frequency that is resolved, in cycles per pixel, at most 0.5.
        level: (rows + 1, columns + 1) as the law has it; above L where more than layer L would be seen.
        rate: (rows + 1, columns + 1) that the cut-off allows.
    """

    width: int
    height: int
    lowest: int
    finest_rates: tuple[int, ...]
    eccentricity: Lattice
    cutoff: Lattice
    level: Lattice
    rate: Lattice

    @property
    def layers(self) -> int:
        """L."""
        return len(self.finest_rates)

    @cached_property
    def drawn_level(self) -> Lattice:
        """Layer as drawn, between two where both are joined.

        A layer fades into the next one just before the boundary of its level, where Fov-GS's Eq. 7 steps
        down: at the edge of the full-quality region the second layer is seen alone.
        """
        left = self.layers - np.minimum(self.level, np.float32(self.layers + 1))
        steps = _soft_ceil((left + np.float32(_FADE)).astype(np.float32))
        return np.clip(self.layers - steps, self.lowest, self.layers)

    @cached_property
    def drawn_rate(self) -> Lattice:
        """Rate as drawn, between two where both are joined."""
        shares = [self._layer_share(n) * self._rate_of(n) for n in range(self.lowest, self.layers + 1)]
        return np.sum(shares, axis=0, dtype=np.float32)

    def share(self, layer: int, rate: int) -> Lattice:
        """Share in the picture, 0..1, of a layer drawn at a rate; all shares together sum to 1."""
        near = np.maximum(1 - np.abs(self._rate_of(layer) - rate), 0)
        return (self._layer_share(layer) * near).astype(np.float32)

    def _layer_share(self, layer: int) -> Lattice:
        return np.maximum(1 - np.abs(self.drawn_level - layer), 0)

    def _rate_of(self, layer: int) -> Lattice:
        # A coarser rate fades in from where it carries all that the cut-off lets through.
        return np.clip(_soft_ceil(self.rate) - 1, self.finest_rates[layer - 1], COARSEST_RATE)


def _soft_ceil(values: Lattice) -> Lattice:
    """Rounds up, but rises to the next integer over a share of the way, from each integer on."""
    whole = np.floor(values)
    return whole + np.minimum((values - whole) / _FADE, 1)


def detail_map(
    display: Display,
    gaze: Gaze,
    width: int,
    height: int,
    law: Law,
    fov_b: float,
    finest_frequency: float,
    finest_rates: tuple[int, ...],
    lowest: int = 1,
    saliency: NDArray[np.float32] | None = None,
) -> DetailMap:
    """The detail that a viewer of a display resolves.

    Args:
        display: the frame is shown around its centre, pixel by pixel.
        gaze: where the viewer looks.
        width, height: frame in pixels.
        law: from eccentricity to cut-off.
        fov_b: radius of the region of full quality, in percent of the height; its edge is Fov-GS's e0.
        finest_frequency: highest frequency that layer L can show, in cycles per pixel of the frame.
        finest_rates: of layers 1 to L, see DetailMap.
        lowest: the coarsest layer that may be drawn.
        saliency: (h, w) in 0..1 over the frame, None for none.
    """
    x, y, per_degree, rays = _corners(display, width, height)
    viewer = display.viewer(width, height)
    position = np.array(gaze.pixel(width, height))
    # Within the region of full quality all is as at its edge, where the periphery begins.
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = position + np.stack([np.cos(around), np.sin(around)], axis=1) * (fov_b / 100 * height)
    edge = float(eccentricity_at(viewer, gaze, circle).min())
    # The chord between unit vectors keeps its precision near zero, as an arc cosine does not.
    chord = np.linalg.norm(rays - viewer.rays(position[None])[0], axis=-1)
    angle = np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1)))
    cutoff = law.cutoff(np.maximum(angle, edge)) / per_degree
    if saliency is not None:
        cutoff = with_saliency(cutoff, _sampled(saliency, x / width, y / height).astype(np.float64))
    finest = min(float(law.cutoff(np.array(edge))) / display.pixels_per_degree, 0.5)
    if not law.relative:
        # What layer L does not show well, no coarser layer need show either.
        finest = min(finest, _FAITHFUL * finest_frequency)
    rate = np.clip(-np.log2(np.minimum(2 * cutoff, 1)), 0, COARSEST_RATE + 1)
    level = continuous_level(cutoff, finest, len(finest_rates))
    arrays = (angle, np.minimum(cutoff, 0.5), level, rate)
    return DetailMap(width, height, lowest, finest_rates, *(a.astype(np.float32) for a in arrays))


@lru_cache(maxsize=4)
def _corners(display: Display, width: int, height: int) -> tuple[NDArray[np.float64], ...]:
    """Of the cells' corners: x and y in pixels, pixels per degree there, and rays (rows, columns, 3)."""
    rows, columns = -(-height // CELL), -(-width // CELL)
    x, y = np.meshgrid(np.arange(columns + 1) * float(CELL), np.arange(rows + 1) * float(CELL))
    # Across the line of sight; along it pixels are seen under a still smaller angle.
    per_degree = np.radians(1) * np.sqrt(display.focal**2 + (x - width / 2) ** 2 + (y - height / 2) ** 2)
    rays = display.viewer(width, height).rays(np.stack([x.ravel(), y.ravel()], axis=1))
    return x, y, per_degree, rays.reshape(*x.shape, 3)


def _sampled(image: NDArray[np.float32], x: NDArray[np.float64], y: NDArray[np.float64]) -> Lattice:
    """The image, linear between its pixels' centres, at positions in fractions of its size."""
    place = [y * image.shape[0] - 0.5, x * image.shape[1] - 0.5]
    return map_coordinates(image, place, order=1, mode="nearest")
