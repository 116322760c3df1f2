"""One estimate of foveal radiance from noisy samples, denoised samples, and biased splats.

The traced radiance is noisy, denoising blurs and invents, splats lack detail and cannot follow changes. The
estimate is a mixture of the splats, as they are and as the samples correct them, and the denoised samples
(compose.fusion.estimates). Two things are built around that:

- The result is drawn towards the traced radiance wherever the two differ by more than noise explains, in
  the spirit of the James-Stein combiner of Gu et al. 2022: with more samples the weight of these goes to 1.
- A parent that is negative, not finite or out of all proportion in a pixel is replaced by another one there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import and_
from typing import TYPE_CHECKING

import drjit as dr
import numpy as np

from compose.base.arrays import constant
from compose.base.frozen import Frozen
from compose.fusion.estimates import Light, candidates_of, evidence, light_of, shares
from compose.fusion.maps import Grid, among, block_means, box_mean, interpolated
from compose.fusion.parents import PARENTS, Parents, Planes
from compose.image.colour import LUMINANCE_WEIGHTS, MOST, outliers

if TYPE_CHECKING:
    from drjit.auto.ad import Float, Float64, TensorXf, UInt

# Relative bias that no estimate but the traced radiance is trusted to stay below.
_FLOOR = 0.005
# How much wider than a normal distribution's the confidence interval around a few samples' bias may be.
_TAILS = 20.0


@dataclass(frozen=True)
class Fused:
    """One estimate of radiance in N pixels, and the weights of PARENTS: three and four channels (N,).

    In `excluded` pixels of the image a parent was left out because it was negative, not finite, or out of
    proportion to its neighbours and to the other parents (compose.image.colour).
    """

    radiance: list[Float]
    weights: list[Float]
    excluded: int


class Fusion:
    """The fusion of a view's parents, in two steps: what its splats are relit by is denoised between them."""

    def __init__(self, parents: Parents):
        self._parents, self._excluded = parents, 0
        self._light = self._lit_by(parents, MOST)
        # The one number that is waited for; a denoiser follows, which waits anyway.
        if not np.isfinite(self._light.brightness[0]):
            self._parents, self._excluded = usable(parents)
            self._light = self._lit_by(self._parents, np.inf)

    @staticmethod
    def _lit_by(parents: Parents, most: float) -> Light:
        limit = constant(parents.arrays.plain.Float, most)
        return _light_of(parents.grids, parents.planes, parents.denoised, limit)

    @property
    def ratio(self) -> TensorXf:
        """(h / 2, w / 2, 3), of samples and splats at half the resolution, with the samples' noise."""
        plain, shape = self._parents.arrays.plain, [-(-side // 2) for side in self._parents.shape]
        place = dr.arange(plain.UInt, 3 * shape[0] * shape[1])
        return plain.TensorXf(dr.gather(plain.Float, self._light.ratio, place), (*shape, 3))

    def fused(self, smooth: TensorXf, pixels: UInt) -> Fused:
        """One estimate from all parents, in pixels (N,); `smooth` is the denoised ratio."""
        radiance, weights = _fused(self._given(smooth))
        return Fused(among(radiance)(pixels), among(weights)(pixels), self._excluded)

    def estimate(self, smooth: TensorXf, pixels: UInt) -> list[Float]:
        """Three channels (N,), before they are drawn towards the samples."""
        return among(_mixed(self._given(smooth))[0])(pixels)

    def candidates(self, smooth: TensorXf) -> tuple[list[list[Float]], list[Float]]:
        """What is mixed, and what its shares depend on (compose.fusion.estimates)."""
        return self._given(smooth).candidates()

    def _given(self, smooth: TensorXf) -> Given:
        given = self._parents
        expected = constant(given.arrays.plain.Float, given.expected)
        return Given(given.grids, given.planes, self._light, smooth.array, given.denoised, expected)


@dataclass(frozen=True)
class Given:
    """What kernels fuse: parents, and their light with its denoised ratio."""

    grids: list[Grid]
    images: Planes
    light: Light
    smooth: Float
    denoised: Float | None
    expected: Float  # of width 1

    def candidates(self) -> tuple[list[list[Float]], list[Float]]:
        """What is mixed, and what its shares depend on (compose.fusion.estimates)."""
        found = candidates_of(self.grids, self.light, self.smooth, self.denoised)
        return found, evidence(self.grids, self.images, self.light, found, self.expected)


def mixed_radiance(given: Given) -> tuple[list[Float], list[Float]]:
    """Three channels of a mixture of the candidates, and a weight of each of these."""
    candidates, seen = given.candidates()
    weights = shares(seen)
    dr.eval(weights)
    row, column, _ = given.grids[0].pixels()
    weights = interpolated(among(weights), given.grids[2].taps(row, column, 2))
    pairs = [zip(weights, channel, strict=True) for channel in zip(*candidates, strict=True)]
    radiance = [dr.sum([weight * value for weight, value in pair]) for pair in pairs]
    dr.eval(radiance, weights)
    return radiance, weights


def fused_radiance(given: Given) -> tuple[list[Float], list[Float]]:
    """Three channels of the estimate, and the weights of PARENTS."""
    estimate, (splat, relit, *others) = mixed_radiance(given)
    kept, grid = trust(given.grids, given.images, estimate), given.grids[0]
    row, column, _ = grid.pixels()
    traced = given.images.at("traced", grid.index(row, column))
    radiance = [dr.lerp(a, b, kept) for a, b in zip(traced, estimate, strict=True)]
    weights = [1 - kept, *[kept * of for of in (*others, relit, splat)]]
    if not others:
        weights.insert(PARENTS.index("denoised"), dr.zeros(type(kept), grid.lanes))
    dr.eval(radiance, weights)
    return radiance, weights


def trust(grids: list[Grid], images: Planes, estimate: list[Float]) -> Float:
    """Share that an estimate of unknown bias, three channels, keeps beside the unbiased one, 0..1.

    v / (v + b^2) is the best share for independent errors of variance v and bias b. The squared bias is
    estimated over about 6 x 6 pixels and taken at the lower end of its confidence interval (two standard
    errors): noise must not count as bias. Where few samples have found light yet, both their mean and their
    variance are too small, so the relative variance of the neighbourhood counts where it is larger; and the
    fewer the samples, the wider the interval may be. Fourth powers of radiance take float64.
    """
    grid, half, _, eighth = grids
    plain = grid.arrays.plain
    wide = plain.Float64

    def moments_at(index: UInt) -> list[Float64]:
        traced, variance = images.at("traced", index), images.at("variance", index)
        own = among(estimate)(index)
        known = reduce(and_, [dr.isfinite(v) for v in variance])
        explained = dr.select(known, dr.sum([wide(v) for v in variance]) * (1 / 3), 0)
        apart = [dr.square(wide(a) - wide(b)) for a, b in zip(own, traced, strict=True)]
        excess = dr.sum(apart) * (1 / 3) - explained
        light = dr.sum([weight * wide(a) for weight, a in zip(LUMINANCE_WEIGHTS, own, strict=True)])
        return [
            excess,
            dr.square(excess),
            explained,
            dr.square(light) + 1e-8,
            wide(images.at("count", index)[0]),
        ]

    row, column, _ = half.pixels()
    *maps, count = block_means(moments_at, grid, row, column, 1)
    dr.eval(maps, count)
    row, column, _ = eighth.pixels()
    large = block_means(among(maps), half, row, column, 2, margin=4)
    dr.eval(large)
    row, column, _ = half.pixels()
    small, large = (
        box_mean(among(maps), half, row, column),
        interpolated(among(large), eighth.taps(row, column, 2)),
    )
    level = small[3]
    explained = dr.maximum(small[2], large[2] / large[3] * level)
    variance = dr.maximum(*[mean[1] - dr.square(mean[0]) for mean in (small, large)])
    error = dr.sqrt(dr.maximum(variance, 0) * (1 / 36))
    error = dr.minimum(error, explained * (1.5 + _TAILS / dr.sqrt(count)))
    bias = dr.maximum(small[0] - 2 * error, _FLOOR**2 * level)
    share = plain.Float(explained / (explained + bias + 1e-20))
    dr.eval(share)
    row, column, _ = grid.pixels()
    known = [dr.isfinite(v) for v in images.at("variance", grid.index(row, column))]
    kept = interpolated(among([share]), half.taps(row, column, 1))[0]
    return dr.select(reduce(and_, known), kept, 1)


_light_of, _mixed, _fused = Frozen(light_of), Frozen(mixed_radiance), Frozen(fused_radiance)


def usable(parents: Parents) -> tuple[Parents, int]:
    """The parents with whatever cannot be radiance replaced, and in how many pixels; see `Fused`."""
    found = parents.images()
    traced, splat, albedo, variance = (found[name] for name in ("traced", "splat", "albedo", "variance"))
    # (H, W, 1) each. Where splats and denoised samples are wrong, they are so in whole patches.
    no_traced = outliers(traced, splat)
    samples = np.where(no_traced, 0, traced)
    no_splat = wrong = outliers(splat, samples, beside=False)
    usable_splat = np.where(no_splat, 0, splat)
    # Denoising has used the neighbouring pixels, so its result is the first substitute for the others.
    for_traced, for_splat = usable_splat, samples
    if "denoised" in found:
        no_denoised = outliers(found["denoised"], samples, usable_splat, beside=False)
        for_traced = for_splat = found["denoised"] = np.where(no_denoised, usable_splat, found["denoised"])
        wrong = wrong | no_denoised
    found["traced"] = np.where(no_traced, for_traced, traced)
    found["splat"] = np.where(no_splat, for_splat, splat)
    found["albedo"] = np.nan_to_num(albedo, posinf=0, neginf=0)
    found["variance"] = np.where(no_traced, np.inf, variance)
    usable = Parents.of_images(parents.arrays, found, parents.expected)
    return usable, int(np.count_nonzero(no_traced | wrong))
