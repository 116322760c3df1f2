"""An octree over what frames saw: where a scene has detail it has many leaves, and each becomes one Gaussian.

A cell is worth dividing by how much its hits differ in colour, summed over the pixels that saw them. Divided
in that order, cells leave about the least squared error of all octrees with as many leaves. So the same tree
tells how many Gaussians a scene has use for, and where they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from compose.camera.coordinate_systems import TYPICAL_DISTANCE
from compose.image.colour import decibels
from splat.model.gaussians import SH_DC
from splat.model.motion import turned
from splat.model.points import Floats, Ints, drawn_in, rows_of, z_curve_keys
from splat.model.trees import Layer, label_codes

# Halvings of the cube around everything: a cell of the last ones is a fraction of a pixel in most frames.
# Beyond this distance, in units of a place, cells grow with it: the sky is not to share them with all else.
_DEPTH, _FAR = 14, 2 * TYPICAL_DISTANCE
# Hits below which a cell is not divided.
_FEWEST = 4
# Standard deviation of a cell's hits, in pixels of the frames that saw them, above which it is divided
# whatever its colours: large Gaussians spill over what is before them.
_LARGEST = 8.0
# What is too large is divided first, the largest before others.
_FIRST = 1e9
_COLOURS = 3
# Of what is brighter on the perceptual scale, no difference counts: lamps would have all leaves. Not 1,
# although displays show no more: what spills over from a lamp is seen around it.
_BRIGHTEST = 4.0


@dataclass(frozen=True)
class _Level:
    """The cells of one level of the tree, in the order of their keys."""

    first: Ints  # (C,) first of the hits
    count: Ints  # (C,) hits
    spread: Floats  # (C,) sum of squared differences from the mean colour
    size: Floats  # (C,) standard deviation of the positions, in pixels
    parent: Ints  # (C,) cell of the level above


class HitTree:
    """An octree over M hits: seeds of single pixels, one standard deviation a pixel, at rest, in a place.

    Hits of different labels, and of surfaces that face different ways, are never in one cell.

    Raises:
        ValueError: there is no hit.
    """

    def __init__(self, hits: Layer):
        if not len(hits):
            raise ValueError("an octree needs at least one hit")
        keys = z_curve_keys(drawn_in(rows_of(hits.gaussians.means), np.zeros(3), _FAR), _DEPTH)
        keys |= _kind(hits).astype(np.uint64) << np.uint64(3 * _DEPTH)
        order = np.argsort(keys, kind="stable")
        self._keys, self._hits = keys[order], hits.select(torch.from_numpy(order))
        self._colour = 0.5 + SH_DC * rows_of(self._hits.gaussians.sh[0])
        self._shown = np.minimum(self._colour, _BRIGHTEST)
        self._means = rows_of(self._hits.gaussians.means)
        self._pixel = np.exp(self._hits.gaussians.log_scales[0].double().numpy())
        self._levels = self._grown()
        self._rank()

    def _grown(self) -> list[_Level]:
        """All levels, coarsest first."""
        levels: list[_Level] = []
        for depth in range(_DEPTH + 1):
            keys = self._keys >> np.uint64(3 * (_DEPTH - depth))
            first = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
            count = np.diff(first, append=len(keys))
            total = np.add.reduceat(self._shown, first, axis=0)
            squares = np.add.reduceat((self._shown**2).sum(axis=1), first)
            spread = np.maximum(squares - (total**2).sum(axis=1) / count, 0)
            centre = np.add.reduceat(self._means, first, axis=0) / count[:, None]
            away = ((self._means - np.repeat(centre, count, axis=0)) ** 2).sum(axis=1)
            size = np.sqrt(np.add.reduceat(away, first) * np.add.reduceat(self._pixel**-2, first)) / count
            above = levels[-1].first if levels else first
            levels.append(_Level(first, count, spread, size, np.searchsorted(above, first, side="right") - 1))
        return levels

    def _rank(self) -> None:
        """How much a cell must be worth to be divided, and what dividing all that are worth more brings."""
        self._worth: list[Floats] = []
        for level in self._levels[:-1]:
            worth = np.where(level.size > _LARGEST, _FIRST * level.size, level.spread)
            worth[level.count < _FEWEST] = 0
            # A cell is there only if those around it are divided.
            above = self._worth[-1] if self._worth else worth
            self._worth.append(np.minimum(worth, above[level.parent]))
        more, less = [], []
        for level, below in zip(self._levels, self._levels[1:], strict=False):
            more.append(np.bincount(below.parent, minlength=len(level.first)) - 1)
            less.append(level.spread - np.bincount(below.parent, below.spread, len(level.first)))
        flat = np.concatenate(self._worth)
        order = np.argsort(-flat, kind="stable")
        self._ranked = flat[order]
        roots = self._levels[0]
        self._counts = len(roots.first) + np.cumsum(np.concatenate(more)[order])
        self._left = roots.spread.sum() - np.cumsum(np.concatenate(less)[order])

    def worth_of(self, count: int) -> float:
        """What a cell must be worth for about `count` leaves, at most."""
        found = int(np.searchsorted(self._counts, count, side="right"))
        return float(self._ranked[min(found, len(self._ranked) - 1)])

    def count_of(self, worth: float) -> int:
        """Number of leaves if cells are divided that are worth more."""
        found = int(np.searchsorted(-self._ranked, -worth, side="left"))
        return int(self._counts[found - 1]) if found else len(self._levels[0].first)

    def psnr_of(self, count: int) -> float:
        """dB of hits in the mean colour of their leaf, on the perceptual scale, with about `count` leaves."""
        found = int(np.searchsorted(self._counts, count, side="right"))
        return decibels(float(self._left[max(found - 1, 0)]) / (len(self._keys) * _COLOURS))

    def _leaves(self, worth: float) -> Ints:
        """First hit of each leaf, in order."""
        found, divided = [], np.ones(len(self._levels[0].first), dtype=bool)
        for number, level in enumerate(self._levels):
            here = divided if number == 0 else divided[level.parent]
            divides = here & (self._worth[number] > worth) if number < _DEPTH else np.zeros_like(here)
            found.append(level.first[here & ~divides])
            divided = divides
        return np.sort(np.concatenate(found))

    def seeds(self, count: int, rng: np.random.Generator) -> Layer:
        """Up to `count` hits, about as many, one of each leaf at random, in the mean colour of its leaf.

        A leaf is where it was hit, also among leaves and bars, where the mean of hits is in the air.
        """
        first = self._leaves(self.worth_of(count))
        hits = np.diff(first, append=len(self._keys))
        if len(first) > count:
            # Not even one for each label and way to face.
            most = np.sort(np.argsort(-hits, kind="stable")[:count])
            first, hits = first[most], hits[most]
        chosen = first + (rng.random(len(first)) * hits).astype(np.int64)
        seeds = self._hits.select(torch.from_numpy(chosen))
        ends = np.stack([first, first + hits], axis=1).ravel()
        total = np.add.reduceat(np.concatenate([self._colour, np.zeros((1, 3))]), ends, axis=0)[::2]
        colour = total / hits[:, None]
        sh = (torch.from_numpy(colour.T.astype(np.float32)) - 0.5)[None] / SH_DC
        return replace(seeds, gaussians=replace(seeds.gaussians, sh=sh))


def _kind(hits: Layer) -> Ints:
    """(M,) a number for each label and each of the six ways that a surface may face."""
    rotations = hits.gaussians.rotations.double()
    along = torch.tensor([[0.0], [0.0], [1.0]], dtype=torch.float64).expand(3, len(hits))
    normal = rows_of(turned(rotations, along))
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0)
    return 6 * np.unique(label_codes(hits), return_inverse=True)[1] + facing
