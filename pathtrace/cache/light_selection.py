"""Selection of a light by what lights give to a place, instead of with equal chances, and shadow rays to it.

The chances are learnt, as those of Vévoda et al. 2018 are, from the light that the points of a cell got.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.base.arrays import uploaded
from pathtrace.cache.cells import Floats, Grid, Indices, Points, Table, cell_names, find
from pathtrace.scene.instances import AnyScene

# Surfaces that a shadow ray passes at most.
_MOST = 32
# Level of the cells that have chances of their own, and samples of each light that such a cell has at least.
_LEVEL = 2
_FEWEST = 64
# Share of all choices that is made with equal chances: no light may be missed.
_EVEN = 0.2


@dr.syntax
def transmittance(
    scene: AnyScene, hit: mi.SurfaceInteraction3f, point: mi.Point3f, active: mi.Bool
) -> mi.Color3f:
    """Share of light (Color3f) from points that passes glass and masks to N interactions; 0 if inactive."""
    share = dr.select(active, mi.Color3f(1), 0)
    going, passed, ray = mi.Bool(active), mi.UInt32(0), hit.spawn_ray_to(point)
    while dr.hint(going, exclude=[scene]):
        between = scene.ray_intersect(ray, mi.RayFlags.All, False, going)
        going &= between.is_valid()
        lets = between.bsdf().eval_null_transmission(between, going)
        # What comes after too many surfaces counts as hidden.
        share = dr.select(going, dr.select(passed < _MOST, share * lets, 0), share)
        going &= dr.max(share) > 0
        ray = dr.select(going, between.spawn_ray_to(point), ray)
        passed += 1
    return share


@dataclass(frozen=True)
class LightSamples:
    """M samples, each light as likely: indices of points and lights, irradiance in any unit, (M,) each."""

    point: Indices
    light: Indices
    irradiance: Floats

    def sums(self, places: Indices, count: int, lights: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Sums of squares by light (R, E), and sample numbers (R,), at R places, by those (M,) of samples."""
        weights = self.irradiance.astype(float) ** 2
        squares = np.bincount(places * lights + self.light, weights=weights, minlength=count * lights)
        return squares.reshape(count, lights), np.bincount(places, minlength=count)


@dataclass(frozen=True, eq=False)
class LightChoice:
    """Chances (R + 1, E), above 0, of E lights in R cells of a grid, by their names, and elsewhere."""

    grid: Grid
    keys: NDArray[np.uint64]
    chances: Floats

    @staticmethod
    def of(samples: LightSamples, points: Points, grid: Grid, lights: int) -> LightChoice:
        """Chances of E lights by samples of points in each cell of a grid."""
        key, cell = np.unique(grid.keys(points, _LEVEL), return_inverse=True)
        place = cell[samples.point]
        squares, numbers = samples.sums(place, len(key), lights)
        kept = numbers >= _FEWEST * lights
        chances = _chances(np.vstack([squares[kept], squares.sum(axis=0)]))
        return LightChoice(grid, key[kept], chances.astype(np.float32))

    def rows(self, points: Points) -> Indices:
        """(N,) row of the chances at each point."""
        key = self.grid.keys(points, _LEVEL)
        row = np.searchsorted(self.keys, key)
        known = np.append(self.keys, np.uint64(0))[row] == key
        return np.where(known, row, len(self.keys))

    def arrays(self, scene: mi.Scene) -> tuple[Any, ...]:
        """For `Lights` in kernels: grid, table, rows, light numbers, chances, and running sums."""
        rows = mi.UInt32(len(self.keys))
        dr.make_opaque(rows)
        numbers = mi.UInt32(light_numbers(scene))
        return self.grid.arrays, Table(self.keys).arrays, rows, numbers, *self.chance_arrays()

    def chance_arrays(self) -> tuple[Any, Any]:
        """The last two of `arrays`: all that changes while a choice is learnt."""
        running = np.cumsum(self.chances, axis=1, dtype=np.float64)
        running = (running / running[:, -1:]).astype(np.float32)
        return uploaded(mi.Float, self.chances), uploaded(mi.Float, running)


class LightLearning:
    """What new samples make, little by little, of the choice before the lights changed."""

    def __init__(self, before: LightChoice):
        self._before = before
        self._squares: NDArray[np.float64] = np.zeros_like(before.chances, dtype=float)
        self._numbers = np.zeros(len(before.chances), dtype=np.int64)

    def add(self, samples: LightSamples, rows: Indices) -> None:
        """Adds samples, given the row of the chances at each of the points that they belong to."""
        count, lights = self._squares.shape
        squares, numbers = samples.sums(rows[samples.point], count, lights)
        # The last row is for all places.
        squares[-1], numbers[-1] = squares.sum(axis=0), numbers.sum()
        self._squares += squares
        self._numbers += numbers

    def choice(self) -> LightChoice:
        """The choice now; all new in the cells that have as many new samples as a cell must have."""
        learnt = np.minimum(self._numbers / (_FEWEST * self._squares.shape[1]), 1)[:, None]
        chances = learnt * _chances(self._squares) + (1 - learnt) * self._before.chances
        return replace(self._before, chances=chances.astype(np.float32))


def _chances(squares: NDArray[np.float64]) -> NDArray[np.float64]:
    lights = squares.shape[1]
    # The chances with the least variance are as the root mean squares.
    rows = np.sqrt(squares)
    total = rows.sum(axis=1, keepdims=True)
    learnt = np.divide(rows, total, out=np.full_like(rows, 1 / lights), where=total > 0)
    return _EVEN / lights + (1 - _EVEN) * learnt


def light_numbers(scene: AnyScene) -> NDArray[np.uint32]:
    """Index of each light in the scene, by the number by which kernels know it."""
    registered = mi.UInt32(dr.reinterpret_array(mi.UInt32, scene.emitters_dr())).numpy()
    numbers = np.zeros(int(registered.max()) + 1, dtype=np.uint32)
    numbers[registered] = np.arange(len(registered))
    return numbers


class Lights:
    """The lights of a Mitsuba scene inside a kernel, chosen by a `LightChoice`, given as its arrays."""

    def __init__(self, scene: AnyScene, arrays: tuple[Any, ...], thin_glass: bool = False):
        self._scene, self._thin_glass = scene, thin_glass
        self._grid, self._table, self._rows, self._numbers, self._chances, self._running = arrays
        self._count = len(scene.emitters())
        self._emitters = scene.emitters_dr()

    def row(self, position: mi.Point3f, side: mi.Normal3f, active: mi.Bool) -> mi.UInt32:
        """Row of chances at N surface points with normals of the lit side."""
        origin, scale = self._grid
        names = cell_names((position - origin) / scale, side, _LEVEL)
        known, cell = find(self._table, *names, active)
        return dr.select(known, cell, self._rows)

    def sample(
        self, hit: mi.SurfaceInteraction3f, row: mi.UInt32, point: mi.Point2f, active: mi.Bool
    ) -> tuple[Any, Any]:
        """As Mitsuba's `Scene.sample_emitter_direction`, without shadows: direction sample and radiance."""
        start = row * self._count
        above = lambda index: dr.gather(mi.Float, self._running, start + index, active) < point.x  # noqa: E731
        number = dr.binary_search(0, self._count - 1, above)
        chance = dr.gather(mi.Float, self._chances, start + number, active)
        end = dr.gather(mi.Float, self._running, start + number, active)
        inside = dr.clip(1 - (end - point.x) / chance, 0, dr.one_minus_epsilon(mi.Float))
        emitter = dr.gather(mi.EmitterPtr, self._emitters, number, active)
        light, emitted = emitter.sample_direction(hit, mi.Point2f(inside, point.y), active)
        lit = active & (light.pdf > 0)
        light.pdf = dr.select(lit, light.pdf * chance, 0)
        return light, dr.select(lit, emitted / chance, 0)

    def arriving(
        self, hit: mi.SurfaceInteraction3f, light: mi.DirectionSample3f, emitted: mi.Color3f, active: mi.Bool
    ) -> mi.Color3f:
        """What arrives of that which sampled places on lights emit, by shadow rays; 0 where it is hidden."""
        if self._thin_glass:
            return emitted * transmittance(self._scene, hit, light.p, active)
        seen = active & ~self._scene.ray_test(hit.spawn_ray_to(light.p), active)
        return dr.select(seen, emitted, 0)

    def pdf(
        self, before: mi.SurfaceInteraction3f, row: mi.UInt32, found: mi.DirectionSample3f, active: mi.Bool
    ) -> mi.Float:
        """As Mitsuba's `Scene.pdf_emitter_direction`."""
        number = dr.gather(mi.UInt32, self._numbers, dr.reinterpret_array(mi.UInt32, found.emitter), active)
        chance = dr.gather(mi.Float, self._chances, row * self._count + number, active)
        return found.emitter.pdf_direction(before, found, active) * chance
