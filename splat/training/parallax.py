"""Distances from parallax: how far away something must be for other views to show it in the same colour.

A plane sweep (Collins 1996): each pixel is tried at a number of distances, and keeps the one at which small
windows around it look most alike in other views. It is coarse, and wrong where there is no texture; but
what is wrong there looks right.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter

from splat.model.perceptual import perceptual_from_radiance
from splat.training.views import TrainingView, reduced

# Pixels, about, of the reduced views that are compared.
_PIXELS = 1 << 12
# Distances that are tried, in equal steps of their inverse, and the least of them over the largest: more
# would take long, or leave gaps of more than a pixel.
_TRIED, _LEAST = 64, 1 / 12
# Views that each one is compared with, and the share of them that must agree: in others it is hidden, or has
# moved.
_OTHERS, _AGREEING = 8, 0.5
# How far apart cameras are that are compared, over the distance of what they show: nearer ones see no
# parallax, farther ones something else.
_NEAR, _FAR = 0.02, 0.35
# Side of the windows, and of the filter that removes outliers, in pixels of reduced views.
_WINDOW, _FILTER = 5, 5
# Difference of a pixel that another view does not show.
_UNSEEN = 1.0

Array = NDArray[np.float64]


class Parallax:
    """Finds distances of views from one another.

    Args:
        views: of what does not move, for the most part.
        nearest, farthest: distances between which everything lies.
        distance: of what they look at, about.
    """

    def __init__(self, views: list[TrainingView], nearest: float, farthest: float, distance: float):
        self._factor = max(1, round(float(np.sqrt(views[0].distance.size / _PIXELS))))
        self._views = [reduced(view, self._factor) for view in views]
        self._colours = [
            perceptual_from_radiance(torch.from_numpy(v.radiance)).numpy().astype(np.float32)
            for v in self._views
        ]
        self._widths = [view.camera.width for view in views]
        self._positions = np.stack([view.camera.position for view in views])
        self._tried = 1 / np.linspace(1 / farthest, 1 / max(nearest, _LEAST * farthest), _TRIED)
        self._distance = distance

    def distances(self, number: int, pixels: NDArray[np.int64]) -> Array:
        """Distances (M,) along the rays through pixels of a view, row-major indices at full resolution."""
        small = self._views[number]
        height, width = small.distance.shape
        others = self._compared(number)
        cost = np.stack([self._cost(number, others, distance) for distance in self._tried])
        found = median_filter(self._tried[np.argmin(cost, axis=0)], _FILTER, mode="nearest")
        full = self._widths[number]
        rows = np.minimum(pixels // full // self._factor, height - 1)
        columns = np.minimum(pixels % full // self._factor, width - 1)
        return found[rows, columns]

    def _compared(self, number: int) -> list[int]:
        """The views that one is compared with: those at a useful distance, evenly over these."""
        apart = np.linalg.norm(self._positions - self._positions[number], axis=1) / self._distance
        useful = np.flatnonzero((apart >= _NEAR) & (apart <= _FAR))
        if not len(useful):
            useful = np.argsort(-apart)[: min(_OTHERS, len(apart) - 1)]
        return useful[np.linspace(0, len(useful) - 1, min(_OTHERS, len(useful))).astype(int)].tolist()

    def _cost(self, number: int, others: list[int], distance: float) -> NDArray[np.float32]:
        """(h, w) how different a view looks in others if all of it is so far away."""
        view, own = self._views[number], self._colours[number]
        height, width = view.distance.shape
        points = view.camera.position + view.rays(np.arange(height * width)) * distance
        costs = []
        for other in others:
            camera, colours = self._views[other].camera, self._colours[other]
            at, depth = camera.project(points)
            inside = (depth > 0) & ((at >= 0) & (at < (camera.width, camera.height))).all(axis=1)
            columns, rows = np.where(inside[:, None], at, 0).astype(np.int64).T
            difference = np.abs(colours[rows, columns] - own.reshape(-1, 3)).mean(axis=1)
            difference[~inside] = _UNSEEN
            costs.append(uniform_filter(difference.reshape(height, width), _WINDOW, mode="nearest"))
        agreeing = max(1, round(_AGREEING * len(others)))
        return np.asarray(np.sort(np.stack(costs), axis=0)[:agreeing].mean(axis=0))
