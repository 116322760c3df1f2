"""How much of the radiance of a scene paths of each length bring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from compose.camera.camera import Camera
from pathtrace.cache.irradiance_cache import IrradianceCache
from pathtrace.scene.scene import Scene
from pathtrace.trace.cached_paths import LONGEST, DepthBins, PathSettings, path_radiance
from pathtrace.trace.film import (
    Sequences,
    mixed_seeds,
    opaque_camera,
    random_numbers,
    ray_through,
    sobol_tables,
)

# Path depth without a bound.
UNBOUNDED = -1
# Longest paths that are told apart.
MOST_SEGMENTS = 64
# Segments from which on roulette ends paths. Later than when rendering: long paths are what is asked for.
_ROULETTE = 8
# Share of the brightest paths that tell nothing of the variance: of fireflies, too few are seen.
_FIREFLIES = 0.01
# Independent parts of the samples of a view, from which errors are found.
_PARTS = 4
# Samples in a row of a sequence.
_ROW = 16


@dataclass(frozen=True)
class DepthShares:
    """Radiance by the number of segments of paths, over all views."""

    # (P, D) mean luminance of P independent parts; paths of 1 to D and more segments.
    radiance: NDArray[np.float64]

    @property
    def shares(self) -> NDArray[np.float64]:
        """(D,) of the whole; all 0 of a scene without light."""
        means = self.radiance.mean(axis=0)
        return means / max(float(means.sum()), 1e-300)

    def beyond(self, segments: int) -> float:
        """Share of the radiance that paths of more segments bring."""
        return float(self.shares[segments:].sum())

    def error_beyond(self, segments: int) -> float:
        """Standard error of that share."""
        totals = self.radiance.sum(axis=1)
        rest = self.radiance[:, segments:].sum(axis=1)
        share = rest.sum() / max(float(totals.sum()), 1e-300)
        # Of a ratio of means, to first order.
        deviations = (rest - share * totals) / max(float(totals.mean()), 1e-300)
        return float(np.std(deviations, ddof=1) / np.sqrt(len(totals)))

    def depth_for(self, share: float) -> int:
        """Least number of segments beyond which there is no more than a share of the radiance, at most D.

        The upper end of the measured share counts, two standard errors above its mean.
        """
        for segments in range(1, self.radiance.shape[1]):
            if self.beyond(segments) + 2 * self.error_beyond(segments) <= share:
                return segments
        return int(self.radiance.shape[1])


@dataclass(frozen=True)
class PathCosts:
    """What paths cost."""

    segments: float  # mean number, without rays to lights
    variance: float  # of luminance within a view, mean over views, without the brightest paths


def depth_shares(scene: Scene, cameras: Sequence[Camera], samples: int, seed: int) -> DepthShares:
    """How much paths of each length bring to what cameras see, by a number of unbiased samples of each."""
    count = -(-samples // _PARTS)
    _, bins = _traced(scene, cameras, count, [(UNBOUNDED, _ROULETTE)] * _PARTS, seed)
    return DepthShares(bins.sums.numpy().reshape(_PARTS, MOST_SEGMENTS) / (count * len(cameras)))


def path_costs(
    scene: Scene, cameras: Sequence[Camera], samples: int, depths: Sequence[tuple[int, int]], seed: int
) -> list[PathCosts]:
    """What paths cost that are no longer than a depth (below 0: any), and play roulette from another.

    For each of up to _PARTS such pairs of depths; each view has a number of samples for each.
    """
    radiance, bins = _traced(scene, cameras, samples, depths, seed)
    found = np.sort(mi.luminance(radiance).numpy().reshape(len(depths), len(cameras), samples))
    variances = found[..., : max(1, int(samples * (1 - _FIREFLIES)))].var(axis=-1).mean(axis=-1)
    # What the camera sees is the first segment of every path.
    segments = 1 + bins.segments.numpy()[: len(depths)] / (len(cameras) * samples)
    return [PathCosts(float(mean), float(var)) for mean, var in zip(segments, variances, strict=True)]


def _traced(
    scene: Scene, cameras: Sequence[Camera], count: int, depths: Sequence[tuple[int, int]], seed: int
) -> tuple[Any, DepthBins]:
    """Radiance of `count` paths spread over the frame of each camera, for one pair of depths after another.

    Also returns what the paths of each pair bring and cost. All in one launch, since with hundreds of lights
    recording one takes ten times as long as its paths.
    """
    state, total = mixed_seeds(seed), count * len(cameras) * len(depths)
    sampler, lane = random_numbers(state, total), dr.arange(mi.UInt32, total)
    group = lane // dr.opaque(mi.UInt32, count * len(cameras))
    number = lane // dr.opaque(mi.UInt32, count) - group * len(cameras)
    of = lambda kind, values, index: dr.gather(kind, kind(list(values)), index)  # noqa: E731
    x = sampler.next_1d() * of(mi.Float, (camera.width for camera in cameras), number)
    y = sampler.next_1d() * of(mi.Float, (camera.height for camera in cameras), number)
    ray = ray_through(dr.concat([opaque_camera(camera) for camera in cameras]), x, y, number)
    sequences = Sequences(sobol_tables(), lane % _ROW, (lane // _ROW, state))
    most, roulette = (
        of(mi.UInt32, (depth if depth >= 0 else LONGEST for depth in each), group)
        for each in zip(*depths, strict=True)
    )
    settings = PathSettings(most, roulette, 1, scene.thin_glass)
    empty = IrradianceCache.empty(len(scene.mitsuba.emitters()))
    surface, active = scene.traced.ray_intersect(ray), mi.Bool(True)
    # As many groups for all, since their number is part of the kernel.
    bins, known = DepthBins(MOST_SEGMENTS, _PARTS, group), empty.arrays(scene.mitsuba)
    radiance = path_radiance(scene.traced, sampler, ray, surface, active, settings, sequences, known, bins)
    dr.eval(radiance, bins.sums, bins.segments)
    return radiance, bins
