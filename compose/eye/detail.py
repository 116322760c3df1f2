"""How much detail a frame needs where: level, sampling rate and cut-off, on a lattice of points.

All three vary slowly, so they are computed at the corners of cells of 16 x 16 pixels and interpolated in
between. They, and the weights that follow from them, are continuous in the gaze: nothing pops.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from compose.eye.acuity import AcuityModel, with_saliency
from compose.eye.display import Display
from compose.eye.gaze import Gaze

CELL = 16  # pixels
COARSEST_RATE = 4  # log2 of pixels per sample along each axis
# Share of an octave over which one step turns into the next. Over a whole octave two of them would be drawn
# nearly everywhere; without any they would pop. Where attention has a say in the level, boundaries move
# faster than the gaze, and the second share holds.
_FADE, _FADE_BY_ATTENTION = 0.22, 0.5
# Gaussians trained on pixels show detail of up to this share of the pixels' Nyquist frequency as it is.
_FAITHFUL = 0.5
Lattice = NDArray[np.float32]


@dataclass(frozen=True)
class Step:
    """A layer at a rate, and from where on it is drawn.

    Attributes:
        octaves: log2 of one over the cut-off, in pixels per cycle, at which it begins to fade in.
        layer: 1, the coarsest, to L.
        rate: log2 of pixels per sample along each axis.
    """

    octaves: float
    layer: int
    rate: int


@dataclass(frozen=True)
class DetailMap:
    """What a frame needs, at the corners of its cells.

    Attributes:
        width, height: frame in pixels.
        layers: L.
        eccentricity: (rows + 1, columns + 1) in degrees.
        cutoff: (rows + 1, columns + 1) highest frequency that is resolved, in cycles per pixel, at most 0.5.
        steps: what is drawn, from fine to coarse.
        place: (rows + 1, columns + 1) where a point is in the steps, 0 for the first; between two whole
            numbers both are joined.
    """

    width: int
    height: int
    layers: int
    eccentricity: Lattice
    cutoff: Lattice
    steps: tuple[Step, ...]
    place: Lattice

    @property
    def drawn_level(self) -> Lattice:
        """Layer as drawn, between two where both are joined."""
        return np.interp(self.place, np.arange(len(self.steps)), [s.layer for s in self.steps]).astype(
            np.float32
        )

    @property
    def drawn_rate(self) -> Lattice:
        """Rate as drawn, between two where both are joined."""
        return np.interp(self.place, np.arange(len(self.steps)), [s.rate for s in self.steps]).astype(
            np.float32
        )

    def share(self, step: int) -> Lattice:
        """Share in the picture, 0..1, of a step; all shares together sum to 1."""
        return np.maximum(1 - np.abs(self.place - np.float32(step)), 0)


def steps_down(
    finest: float, ahead: float, finest_rates: tuple[int, ...], lowest: int, fade: float
) -> tuple[Step, ...]:
    """What is drawn as the cut-off falls: layer after layer, each at one rate.

    A layer fades into the next one just before the boundary of its level, where Fov-GS's Eq. 7 steps down:
    at the edge of the full-quality region the second layer is seen alone. With the layer changes the rate,
    to the coarsest one that still carries what the cut-off lets through there. Only where a layer is
    needed over many octaves, as the finest and the coarsest are, its rate changes alone.

    Args:
        finest: the cut-off, in cycles per pixel, down to which layer L is needed.
        ahead: the same for a viewer who looks straight ahead. Rates follow from it: they must not change
            with the gaze, or a whole layer would pop.
        finest_rates: of layers 1 to L, the finest rate that is worth its samples.
        lowest: the coarsest layer that may be drawn.
        fade: share of an octave over which a step fades in.
    """
    layers = len(finest_rates)
    steps = [Step(-np.inf, layers, finest_rates[-1])]
    first = -np.log2(finest) - fade if lowest < layers else np.inf
    # A rate carries frequencies up to half its samples: rate r begins at 1 + r octaves.
    for rate in range(steps[0].rate + 1, COARSEST_RATE + 1):
        if lowest == layers or 1 + rate + fade <= -np.log2(ahead) - fade:
            steps.append(Step(1.0 + rate, layers, rate))
    for layer in range(layers - 1, lowest - 1, -1):
        below = layers - 1 - layer
        carried = min(int(np.floor(below - np.log2(ahead) - 1)), COARSEST_RATE)
        steps.append(Step(first + below, layer, max(carried, steps[-1].rate, finest_rates[layer - 1])))
    for rate in range(steps[-1].rate + 1, COARSEST_RATE + 1):
        steps.append(Step(max(1.0 + rate, steps[-1].octaves + fade), lowest, rate))
    return tuple(steps)


def detail_map(
    display: Display,
    gaze: Gaze,
    width: int,
    height: int,
    acuity_model: AcuityModel,
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
        acuity model: from eccentricity to cut-off.
        fov_b: radius of the region of full quality, in percent of the height; its edge is Fov-GS's e0.
        finest_frequency: highest frequency that layer L can show, in cycles per pixel of the frame.
        finest_rates: of layers 1 to L, the finest rate that is worth its samples.
        lowest: the coarsest layer that may be drawn.
        saliency: (rows + 1, columns + 1) in 0..1 at the cells' corners, None for none.
    """
    per_degree, rays = _corners(display, width, height)
    viewer = display.viewer(width, height)
    position = np.array(gaze.pixel(width, height))
    # Within the region of full quality all is as at its edge, where the periphery begins.
    around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = position + np.stack([np.cos(around), np.sin(around)], axis=1) * (fov_b / 100 * height)
    ray = viewer.rays(position[None])[0]
    edge = float(np.degrees(np.arccos(min(1.0, (viewer.rays(circle) @ ray).max()))))
    # Near zero an arc cosine loses half of its digits; what is left is more than float32 holds.
    angle = np.degrees(np.arccos(np.clip(rays @ ray, -1, 1)))
    cutoff = acuity_model.cutoff(np.maximum(angle, edge)) / per_degree
    deciding = cutoff
    if saliency is not None:
        cutoff = with_saliency(cutoff, saliency.astype(np.float64))
        deciding = deciding if acuity_model.relative else cutoff
    straight = float(np.degrees(np.arctan(fov_b / 100 * height / display.focal)))
    # What layer L does not show well, no coarser layer need show either.
    most = 0.5 if acuity_model.relative else min(0.5, _FAITHFUL * finest_frequency)
    needed = [
        min(float(acuity_model.cutoff(np.array(e))) / display.pixels_per_degree, most)
        for e in (edge, straight)
    ]
    fade = _FADE if acuity_model.relative else _FADE_BY_ATTENTION
    steps = steps_down(needed[0], needed[1], finest_rates, lowest, fade)
    with np.errstate(divide="ignore"):
        octaves = -np.log2(deciding)
    place = np.zeros_like(cutoff)
    for step in steps[1:]:
        place += np.clip((octaves - step.octaves) / fade, 0, 1)
    single = lambda values: values.astype(np.float32)  # noqa: E731
    lattices = single(angle), single(np.minimum(cutoff, 0.5))
    return DetailMap(width, height, len(finest_rates), *lattices, steps, single(place))


@lru_cache(maxsize=4)
def _corners(display: Display, width: int, height: int) -> tuple[NDArray[np.float64], ...]:
    """Of the cells' corners: pixels per degree there, and rays (rows, columns, 3)."""
    x, y = _corner_positions(width, height)
    # Across the line of sight; along it pixels are seen under a still smaller angle.
    per_degree = np.radians(1) * np.sqrt(display.focal**2 + (x - width / 2) ** 2 + (y - height / 2) ** 2)
    rays = display.viewer(width, height).rays(np.stack([x.ravel(), y.ravel()], axis=1))
    return per_degree, rays.reshape(*x.shape, 3)


def _corner_positions(width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows, columns = -(-height // CELL), -(-width // CELL)
    x, y = np.meshgrid(np.arange(columns + 1) * float(CELL), np.arange(rows + 1) * float(CELL))
    return x, y


def at_corners(image: NDArray[np.float32], width: int, height: int) -> Lattice:
    """A coarse picture (h, w) of a frame, linear between its pixels' centres, at the corners of the cells."""
    x, y = _corner_positions(width, height)
    place = [y / height * image.shape[0] - 0.5, x / width * image.shape[1] - 0.5]
    return map_coordinates(image, place, order=1, mode="nearest")
