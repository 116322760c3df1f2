"""Distances for frames that do not have any: guesses, which training replaces by what its Gaussians show.

From known points where there are some; else from the hull of what is not empty; else from parallax by a plane
sweep (Collins 1996): each pixel is tried at a number of distances, and keeps the one at which small windows
around it look most alike in other views. Where there is no texture, it is wrong, but looks right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter
from scipy.spatial import cKDTree

from compose.base.arrays import Arrays
from compose.camera.camera import Camera
from splat.model.gaussians import SH_DC, Gaussians, perceptual_from_radiance
from splat.model.points import Floats, Ints
from splat.raster.differentiable import render_differentiable
from splat.training.training_view import TrainingView, reduced

# Pixels, about, of the reduced views that are compared.
_PIXELS = 1 << 12
# Distances that are tried, in equal steps of their inverse, and the least of them over the largest.
_TRIED, _LEAST = 64, 1 / 12
# Views that each one is compared with, and the share of them that must agree: in others it is hidden.
_OTHERS, _AGREEING = 8, 0.5
# How far apart compared cameras are, over the distance of what they show: nearer ones see no parallax.
_NEAR, _FAR = 0.02, 0.35
# Side of the windows, and of the filter that removes outliers, in pixels of reduced views.
_WINDOW, _FILTER = 5, 5
# Difference of a pixel that another view does not show.
_UNSEEN = 1.0


class Parallax:
    """Finds distances between the nearest and the farthest by comparing views of what hardly moves.

    `distance` is about that of what they look at.
    """

    def __init__(self, views: list[TrainingView], nearest: float, farthest: float, distance: float):
        self._factor = max(1, round(float(np.sqrt(views[0].distance.size / _PIXELS))))
        self._views = [reduced(view, self._factor) for view in views]
        images = (torch.from_numpy(view.radiance) for view in self._views)
        self._colours = [perceptual_from_radiance(image).numpy().astype(np.float32) for image in images]
        self._widths = [view.camera.width for view in views]
        self._positions = np.stack([view.camera.position for view in views])
        self._tried = 1 / np.linspace(1 / farthest, 1 / max(nearest, _LEAST * farthest), _TRIED)
        self._distance = distance

    def distances(self, number: int, pixels: Ints) -> Floats:
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
            at, inside = camera.shows(points)
            columns, rows = np.where(inside[:, None], at, 0).astype(np.int64).T
            difference = np.abs(colours[rows, columns] - own.reshape(-1, 3)).mean(axis=1)
            difference[~inside] = _UNSEEN
            costs.append(uniform_filter(difference.reshape(height, width), _WINDOW, mode="nearest"))
        agreeing = max(1, round(_AGREEING * len(others)))
        return np.asarray(np.sort(np.stack(costs), axis=0)[:agreeing].mean(axis=0))


# Pixels of a view, about, that get a guess of their own; those around them get the same.
_GUESSES = 1 << 14
# Points around a pixel, the median of whose distances is its guess.
_AROUND = 5
# Without bounds: nearest and farthest, over the distance of where the cameras look.
_NEAREST, _FARTHEST = 0.3, 2.0
# Cells of the hull's grid along each axis, and steps of a ray through it.
_CELLS = 64
_STEPS = 128
# The first cell of a ray is hit that is filled in nearly as many views as any: what moves is in few of them.
_NEARLY = 0.9
# Of the smallest eigenvalue of a mean of projections: less is that of axes that are all but parallel.
_PARALLEL = 1e-4


def with_guesses(
    views: list[TrainingView], points: Floats | None = None, bounds: tuple[float, float] | None = None
) -> list[TrainingView]:
    """Views with a guess of each distance that is not known, and normals towards them.

    Args:
        views: of the world; distances are NaN where they are unknown, inf where nothing is.
        points, bounds: (M, 3) some of what the views show, and its nearest and farthest distance, if known.
    """
    if not views:
        return []
    source, found = _source(views, points, bounds), []
    for number, view in enumerate(views):
        height, width = view.distance.shape
        stride = max(1, int(np.ceil(np.sqrt(height * width / _GUESSES))))
        rows, columns = (np.minimum(np.arange(0, n, stride) + stride // 2, n - 1) for n in (height, width))
        some = source(number, (rows[:, None] * width + columns).ravel()).reshape(len(rows), len(columns))
        guess = np.repeat(np.repeat(some, stride, axis=0), stride, axis=1)[:height, :width]
        rays = view.rays(np.arange(height * width)).reshape(height, width, 3)
        distance = np.where(np.isnan(view.distance), guess, view.distance).astype(np.float32)
        normal = (-rays).astype(np.float32)
        found.append(replace(view, distance=distance, normal=normal, guessed=True))
    return found


# Distances (M,) along the rays through pixels of a view, from its number and row-major indices (M,).
_Source = Callable[[int, Ints], Floats]


def _source(views: list[TrainingView], points: Floats | None, bounds: tuple[float, float] | None) -> _Source:
    middle, distance = focus([view.camera for view in views])
    nearest, farthest = bounds or (_NEAREST * distance, _FARTHEST * distance)
    if points is not None and len(points):
        return partial(_among_points, views, points, farthest)
    if any(np.isinf(view.distance).any() for view in views):
        return _Hull(views, middle, distance).distances
    if len(views) == 1:
        guess = float(np.sqrt(nearest * farthest))
        return lambda number, pixels: np.full(len(pixels), guess)
    return Parallax(views, nearest, farthest, distance).distances


def focus(cameras: list[Camera]) -> tuple[Floats, float]:
    """Where cameras look: the point (3,) nearest to all their axes, and its median distance from them.

    Of axes that are all but parallel, a point a few times as far in front as the cameras are apart.
    """
    positions = np.stack([camera.position for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.mean(axis=0)
    if np.linalg.eigvalsh(total)[0] > _PARALLEL:
        point = np.linalg.solve(total, (across @ positions[:, :, None]).mean(axis=0)[:, 0])
        distance = float(np.median(np.einsum("ij,ij->i", point - positions, axes)))
        if distance > 0:
            return point, distance
    middle, apart = positions.mean(axis=0), float(positions.std(axis=0).max())
    distance = 4 * apart or 1.0
    return middle + axes.mean(axis=0) * distance, distance


def _among_points(
    views: list[TrainingView], points: Floats, otherwise: float, number: int, pixels: Ints
) -> Floats:
    """Median distances of the known points that are seen around pixels; `otherwise` if a view shows none."""
    camera = views[number].camera
    at, inside = camera.shows(points)
    at, distance = at[inside], np.linalg.norm(points[inside] - camera.position, axis=1)
    if not len(at):
        return np.full(len(pixels), otherwise)
    centres = np.stack([pixels % camera.width + 0.5, pixels // camera.width + 0.5], axis=1)
    _, near = cKDTree(at).query(centres, k=np.arange(1, min(_AROUND, len(at)) + 1), workers=-1)
    return np.median(distance[near], axis=1)


class _Hull:
    """Where views show that something is: a grid around what they look at, and per cell a share of views."""

    def __init__(self, views: list[TrainingView], middle: Floats, distance: float):
        self._views, self._middle, self._distance = views, middle, distance
        self._half = float(np.median([distance * view.camera.width / 2 / view.camera.fx for view in views]))
        axis = ((np.arange(_CELLS) + 0.5) / _CELLS * 2 - 1) * self._half
        cells = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3) + self._middle
        filled, seen = np.zeros(len(cells)), np.zeros(len(cells))
        for view in views:
            at, inside = view.camera.shows(cells)
            columns, rows = at[inside].astype(np.int64).T
            seen[inside] += 1
            filled[inside] += ~np.isinf(view.distance[rows, columns])
        # A cell that hardly any view shows is not proven to be anything.
        self._share = np.where(seen >= len(views) / 2, filled / np.maximum(seen, 1), 0)

    def distances(self, number: int, pixels: Ints) -> Floats:
        """Distances to the hull along rays through pixels; to the grid's middle where they miss it."""
        view = self._views[number]
        found = np.full(len(pixels), self._distance)
        chosen = np.flatnonzero(np.isnan(view.distance.ravel()[pixels]))
        rays, position = view.rays(pixels[chosen]), view.camera.position
        reach = np.sqrt(3) * self._half
        nearest = np.linalg.norm(self._middle - position) - reach
        steps = np.linspace(max(nearest, 1e-3 * reach), nearest + 2 * reach, _STEPS)
        points = position + rays[:, None] * steps[:, None] - (self._middle - self._half)
        cell = np.floor(points / (2 * self._half) * _CELLS).astype(np.int64)
        inside = ((cell >= 0) & (cell < _CELLS)).all(axis=2)
        index = np.ravel_multi_index(tuple(np.clip(cell, 0, _CELLS - 1).transpose(2, 0, 1)), (_CELLS,) * 3)
        share = np.where(inside, self._share[index], 0)
        most = share.max(axis=1)
        first = np.argmax(share >= _NEARLY * most[:, None], axis=1)
        found[chosen] = np.where(most > 0, steps[first], self._distance)
        return found


# Coverage of a pixel above which its Gaussians tell where its surface is.
_COVERED = 0.5


def measured(arrays: Arrays, gaussians: Gaussians, view: TrainingView) -> TrainingView:
    """A view whose guessed distances are those that Gaussians show, where they cover a pixel.

    Distances are rasterized as if they were colours: the mean over a pixel's Gaussians, by their weights.
    Where nothing is, nothing changes.
    """
    position = torch.from_numpy(view.camera.position).float()
    distance = (gaussians.means - position[:, None]).norm(dim=0)
    here = torch.nonzero(distance < view.sky / 2)[:, 0]
    if not len(here):
        return view
    unit = distance[here].median().clamp(min=1e-6)
    values = torch.stack([distance[here] / unit, torch.ones(len(here)), torch.zeros(len(here))])
    sh = ((perceptual_from_radiance(values) - 0.5) / SH_DC)[None]
    shown = replace(gaussians.select(here), sh=sh, directional=None)
    with torch.no_grad():
        image = render_differentiable(arrays, shown, view.camera).numpy()
    total, coverage = image[..., 0] * float(unit), image[..., 1]
    known = (coverage > _COVERED) & (view.distance < view.sky)
    found = np.where(known, total / np.maximum(coverage, _COVERED), view.distance)
    return replace(view, distance=found.astype(np.float32))
