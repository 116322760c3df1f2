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
from pathtrace.cache.cache import IrradianceCache
from pathtrace.cache.cells import Grid
from pathtrace.scene.scene import Scene
from pathtrace.trace.cached_paths import PathSettings, path_radiance
from pathtrace.trace.rays import opaque_camera, ray_through
from pathtrace.trace.sequences import Sequences, sobol_tables

# Longest paths that are told apart.
MOST_SEGMENTS = 64
# Segments from which on roulette ends paths. Later than when rendering: long paths are what is asked for.
_ROULETTE = 8
# Independent parts of the samples of a view, from which errors are found.
_PARTS = 4
# Samples in a row of a sequence.
_ROW = 16


@dataclass(frozen=True)
class DepthShares:
    """Radiance by the number of segments of paths, over all views.

    Attributes:
        radiance: (P, D) mean luminance of each of P independent parts; of paths of 1 to D segments, the last
            of which stands for all that are longer.
    """

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
        """Least number of segments beyond which there is no more than a share of the radiance.

        The upper end of the measured share counts, two standard errors above its mean. Where paths of
        MOST_SEGMENTS still bring more, that number.
        """
        for segments in range(1, self.radiance.shape[1]):
            if self.beyond(segments) + 2 * self.error_beyond(segments) <= share:
                return segments
        return int(self.radiance.shape[1])


class _Bins:
    """Adds up luminance by the number of segments."""

    def __init__(self) -> None:
        self.sums = dr.zeros(mi.Float, MOST_SEGMENTS)

    def add(self, radiance: Any, segments: Any) -> None:
        luminance = mi.luminance(radiance)
        index = dr.minimum(segments, MOST_SEGMENTS) - 1
        dr.scatter_add(self.sums, luminance, index, dr.isfinite(luminance) & (luminance > 0))


def depth_shares(scene: Scene, cameras: Sequence[Camera], samples: int, seed: int) -> DepthShares:
    """How much paths of each length bring to what cameras see; unbiased, without a bound on their length.

    Args:
        scene: the scene.
        cameras: views.
        samples: paths of each view, spread over the frame.
        seed: same seed, same result on the same machine.
    """
    settings = PathSettings(-1, _ROULETTE, 1, scene.thin_glass)
    empty = IrradianceCache.empty(Grid(np.zeros(3, dtype=np.float32), 1.0), len(scene.mitsuba.emitters()))
    known, count = empty.arrays(scene.mitsuba), -(-samples // _PARTS)
    means = np.zeros((_PARTS, MOST_SEGMENTS))
    for part in range(_PARTS):
        for number, camera in enumerate(cameras):
            state = np.random.SeedSequence([seed, part, number]).generate_state(1)[0]
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(dr.opaque(mi.UInt32, int(state)), count)
            x, y = sampler.next_1d() * camera.width, sampler.next_1d() * camera.height
            ray = ray_through(opaque_camera(camera), x, y)
            lane = dr.arange(mi.UInt32, count)
            scramble = lane // _ROW, dr.opaque(mi.UInt32, int(state))
            sequences = Sequences(sobol_tables(), lane % _ROW, scramble)
            bins, surface, active = _Bins(), scene.mitsuba.ray_intersect(ray), mi.Bool(True)
            paths = scene.mitsuba, sampler, ray, surface, active, settings, sequences, known
            radiance = path_radiance(*paths, bins)
            dr.eval(radiance, bins.sums)
            means[part] += bins.sums.numpy() / count
    return DepthShares(means / len(cameras))
