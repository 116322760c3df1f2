"""A forest in other light than that it was trained in: its radiance follows the irradiance of surfaces.

The ratio of irradiance after a change to that before it is a factor on the radiance of what is there, as in a
quotient image (Riklin-Raviv and Shashua 2001). It is exact for diffuse surfaces; gloss is scaled as much, and
so are emitters, by the light around them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pathtrace.cache.cells import SIDES, Cells, Floats, Indices
from pathtrace.cache.irradiance_cache import IrradianceCache
from splat.model.dynamic_light import in_light
from splat.model.forest import Forest
from splat.model.gaussians import Gaussians
from splat.model.motion import turned

# Points of a cache that tell the light of nodes, at most, and how many of them tell that of each node.
_POINTS, _NEAREST = 1 << 16, 4
# Weight of a point on a surface that is perpendicular to a flat node.
_ACROSS = 0.01
# Share of the mean irradiance that counts as none, the least that does not, and the largest factor: ratios of
# little mean nothing.
_DARK, _BLACK, _LARGEST = 1e-3, 1e-12, 8.0


@dataclass(frozen=True)
class _Places:
    """Where N nodes have their light from, in a cache and in that of another light."""

    cells: tuple[Indices, Indices]  # (P,) of points in each of the two caches
    nearest: Indices  # (N, K) points
    weights: Floats  # (N, K) of these, whose sum is 1; 0 for nodes that are near no surface

    @staticmethod
    def of(
        usual: IrradianceCache, other: IrradianceCache, position: NDArray[np.float64], axis: Floats
    ) -> _Places:
        """Of nodes at positions (N, 3) in the world, each thinnest along an axis (N, 3)."""
        # Both are asked at the same points: edges of shadows pass between others.
        points = other.transfer.points
        points = points.take(np.arange(min(len(points), _POINTS)))
        cells = usual.cells.smallest(points), other.cells.smallest(points)
        known = np.minimum(*cells) >= 0
        points, cells = points.take(known), (cells[0][known], cells[1][known])
        if not len(points):
            nothing = np.zeros((len(position), 0))
            return _Places(cells, nothing.astype(np.int64), nothing.astype(np.float32))
        count = np.arange(1, min(_NEAREST, len(points)) + 1)
        away, nearest = cKDTree(points.position).query(position, k=count, workers=-1)
        weights = np.abs(np.einsum("nkc,nc->nk", points.normal[nearest], axis)) + _ACROSS
        weights *= away < SIDES[-1] * other.cells.grid.scale
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), _ACROSS)
        return _Places(cells, nearest, weights.astype(np.float32))

    def change(self, usual: IrradianceCache, other: IrradianceCache) -> Floats:
        """(3, N) irradiance in the other light over the usual one; 1 for nodes near no surface."""
        before, after = (
            np.einsum("nk,nkc->cn", self.weights, cache.irradiance[-1][cells[self.nearest]])
            for cache, cells in zip((usual, other), self.cells, strict=True)
        )
        least = max(_DARK * float(before.mean()), _BLACK)
        return np.minimum((after + least) / (before + least), np.float32(_LARGEST))


class ForestLight:
    """Draws a forest in other light; `usual` is the cache of the scene as the forest shows it."""

    def __init__(self, forest: Forest, usual: IrradianceCache):
        self._forest, self.usual = forest, usual
        sets = [forest.nodes.gaussians]
        if forest.hierarchy is not None and forest.hierarchy.inner is not None:
            sets.append(forest.hierarchy.inner)
        self._position = forest.place.in_world(np.concatenate([of.means.numpy().T for of in sets]))
        self._axis = np.concatenate([_thinnest(of) for of in sets])
        # For caches of the same cells, as they are while lights change.
        self._places: tuple[Cells, _Places] | None = None

    def under(self, cache: IrradianceCache) -> Forest:
        """The forest in the light of a cache, which may be that of a changed version of the scene."""
        if self._places is None or self._places[0] is not cache.cells:
            self._places = cache.cells, _Places.of(self.usual, cache, self._position, self._axis)
        factors = torch.from_numpy(self._places[1].change(self.usual, cache))
        forest, count, hierarchy = self._forest, len(self._forest.nodes), self._forest.hierarchy
        nodes = replace(forest.nodes, gaussians=_lit(forest.nodes.gaussians, factors[:, :count]))
        if hierarchy is not None and hierarchy.inner is not None:
            hierarchy = replace(hierarchy, inner=_lit(hierarchy.inner, factors[:, count:]))
        return replace(forest, nodes=nodes, hierarchy=hierarchy)


def _thinnest(gaussians: Gaussians) -> Floats:
    """(N, 3) unit axes along which Gaussians are thinnest."""
    axes = torch.nn.functional.one_hot(gaussians.log_scales.argmin(dim=0), 3).T.float()
    turns = gaussians.rotations / gaussians.rotations.norm(dim=0).clamp(min=1e-12)
    return turned(turns, axes).numpy().T


def _lit(gaussians: Gaussians, factors: torch.Tensor) -> Gaussians:
    return in_light(gaussians, torch.arange(len(gaussians)), factors)
