"""Estimates of radiance from splats and few samples, and how they are mixed by what the samples tell.

Splats are corrected in two ways. They are sharpened: where the traced albedo varies within the size of a
splat, so must the radiance. And they are relit: what the samples have more or less than the splats varies
slowly, so that its ratio is denoised at half the resolution, in a tenth of the time that denoising all of the
radiance takes, and the splats keep their detail (a ratio estimator, as Heitz et al. 2018 denoise shadows).

All is measured in radiance x relative to its level l, as x / (x + l): that depends on no unit, and an outlier
counts for 1 at most. Images are channels of the pixels of a Grid, the finest of several.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import and_, or_
from typing import TYPE_CHECKING

import drjit as dr

from compose.fusion.maps import Grid, among, block_means, box_mean, interpolated, pixels_of
from compose.fusion.parents import Planes

if TYPE_CHECKING:
    from drjit.auto.ad import Bool, Float, Int, UInt

# Logarithm of the odds of each further estimate against the splats, for each channel of `evidence`, with
# denoised samples and without: by `python -m benchmarks.fit_fusion`.
ODDS = (
    (-1.416, -0.325, -0.086, 0.332, -0.216, 0.172, 0.095, 0.281, -0.384, 1.286),  # relit splats
    (3.069, -0.123, 0.675, 0.115, -0.522, 0.210, 0.605, 0.057, 0.363, -0.274),  # denoised samples
)
QUICK_ODDS = ((5.065, -1.061, 0.582, 0.899, 0.849),)
_FURTHEST, _MOST_SAMPLES = 3.0, 64.0
# Within which the expected error of splats counts.
_LEAST, _MOST = 1e-5, 1e-2
# Squared differences below this count as none, and light below this share of the image's as dark.
_SAME, _DARK = 1e-5, 0.1
# Albedo below this counts as black: its logarithm would be noise.
_BLACK = 0.03
# Share of its texture that the splats seem to lack where they lack none: samples share their noise with the
# albedo.
_SHARED = 0.25
# Of what counts as dark, added to radiance before it is divided; and the largest quotient.
_OFFSET, _MOST_RATIO = 0.5, 100.0


@dataclass(frozen=True)
class Light:
    """What samples say of the splats: how much texture they lack, and by what to relight them.

    Attributes:
        brightness: of width 1, the sum of the roots of all radiance; NaN if any of it is out of range.
        level: radiance beside which differences count.
        splat: three channels, sharpened.
        ratio: three channels of the half grid, pixel by pixel: how much more light samples have than splats.
    """

    brightness: Float
    level: Float
    splat: list[Float]
    ratio: Float


def light_of(grids: list[Grid], images: Planes, denoised: Float | None, most: Float) -> Light:
    """What the samples of a view say of its splats, whose radiance must be from 0 to `most`, of width 1."""
    grid, half = grids[:2]
    row, column, known = grid.pixels()
    index = grid.index(row, column)
    traced, splat = images.at("traced", index), images.at("splat", index)
    radiance = [*traced, *splat, *([] if denoised is None else pixels_of(denoised)(index))]
    finite = [dr.isfinite(a) for a in images.at("albedo", index)]
    usual = reduce(and_, [(x >= 0) & (x <= most) for x in radiance], reduce(and_, finite))
    roots = dr.sum([dr.sqrt(0.5 * (a + b)) for a, b in zip(traced, splat, strict=True)])
    # Lanes beyond the pixels repeat the last ones.
    brightness = dr.sum(dr.select(known, roots, 0) + dr.select(usual, 0, dr.nan))
    level = dr.sum(splat) * (1 / 3) + _dark(grid, brightness)
    texture = _texture(grid, images, row, column)
    # Around the disc the samples are the splats themselves.
    differs = known & reduce(or_, [a != b for a, b in zip(traced, splat, strict=True)])
    by_texture, weight = _texture_products([traced, splat, texture], level, differs)
    dr.eval(level, texture, by_texture, weight)
    lacking = dr.clip(dr.sum(by_texture) / dr.maximum(dr.sum(weight), _SAME) - _SHARED, 0, 1)
    splat = [x * dr.exp(lacking * t) for x, t in zip(splat, texture, strict=True)]
    dr.eval(splat)
    ratio = _ratio(grid, half, images, splat, _OFFSET * _dark(grid, brightness))
    dr.eval(ratio)
    return Light(brightness, level, splat, ratio)


def _dark(grid: Grid, brightness: Float) -> Float:
    """Radiance that counts as dark, of width 1: a share of the image's.

    That is the square of its mean root, which few bright samples do not raise.
    """
    kind = type(brightness)
    return _DARK * dr.square(brightness / (3 * kind(grid.height) * kind(grid.width))) + 1e-30


def _texture_products(images: list[list[Float]], level: Float, differs: Bool) -> tuple[Float, Float]:
    """Two numbers of pixels that differ; the quotient of their sums is how much of a texture splats lack.

    By least squares; images are samples, splats and texture.
    """
    traced, splat, texture = images
    # By which each unit of texture changes what is seen of the splats.
    seen = [_seen(x, level) for x in splat]
    change = [dr.select(differs, s * (1 - s) * t, 0) for s, t in zip(seen, texture, strict=True)]
    lack = [_seen(x, level) - s for x, s in zip(traced, seen, strict=True)]
    by_texture = dr.sum([c * x for c, x in zip(change, lack, strict=True)])
    return by_texture, dr.sum([dr.square(c) for c in change])


def _texture(grid: Grid, images: Planes, row: Int, column: Int) -> list[Float]:
    """Logarithm of the albedo over its means in windows of 3 pixels."""
    albedo = images.at("albedo", grid.index(row, column))
    means = box_mean(lambda index: images.at("albedo", index), grid, row, column)
    return [dr.log(a + _BLACK) - dr.log(m + _BLACK) for a, m in zip(albedo, means, strict=True)]


def _ratio(grid: Grid, half: Grid, images: Planes, splat: list[Float], offset: Float) -> Float:
    row, column, _ = half.pixels()
    both = lambda index: [*images.at("traced", index), *among(splat)(index)]  # noqa: E731
    means = block_means(both, grid, row, column, 1)
    # Where both are dark, it would be noise.
    pairs = zip(means[:3], means[3:], strict=True)
    found = [dr.minimum((a + offset) / (b + offset), _MOST_RATIO) for a, b in pairs]
    return grid.arrays.plain.Float(dr.ravel(grid.arrays.plain.Array3f(*found)))


def candidates_of(
    grids: list[Grid], light: Light, smooth: Float, denoised: Float | None
) -> list[list[Float]]:
    """Splats, relit splats and, if there are any, denoised samples: three channels each.

    Relit splats are splats times the denoised ratio, `smooth`, of the half grid, pixel by pixel.
    """
    grid, half = grids[:2]
    row, column, _ = grid.pixels()
    offset, ratio = (
        _OFFSET * _dark(grid, light.brightness),
        interpolated(pixels_of(smooth), half.taps(row, column, 1)),
    )
    relit = [dr.maximum(r * (x + offset) - offset, 0) for r, x in zip(ratio, light.splat, strict=True)]
    found = [light.splat, relit]
    if denoised is not None:
        found.append(pixels_of(denoised)(grid.index(row, column)))
    dr.eval(found)
    return found


def shares(seen: Sequence[Float]) -> list[Float]:
    """Weights of the 2 or 3 candidates in a mixture by what is seen of them (`evidence`).

    They are logistic in the logarithms of what is seen: what a filter got wrong cannot be told from the
    samples that it has seen, but follows a power of what it removed, at all sample counts alike.
    """
    table = QUICK_ODDS if len(seen) == len(QUICK_ODDS[0]) else ODDS
    odds = [dr.sum([o * channel for o, channel in zip(row, seen, strict=True)]) for row in table]
    most = reduce(dr.maximum, odds, type(odds[0])(0))
    parts = [dr.exp(-most), *[dr.exp(value - most) for value in odds]]
    total = dr.sum(parts)
    return [part / total for part in parts]


def evidence(
    grids: list[Grid], images: Planes, light: Light, candidates: list[list[Float]], expected: Float
) -> list[Float]:
    """What the odds of an estimate against the splats depend on: 5 or 10 channels of the quarter grid.

    The channels are 1; the logarithms of what relit splats lack of the samples and of how far they are from
    the splats, both squared; and how far the samples lie on the way from the splats to them. Then, the
    logarithm of the error that is expected of splats; or with denoised samples, the three of these, the last
    one from halfway and times the doublings of the sample count, with which it is known better; how far these
    are from relit splats, and the samples on the way there; and the share of samples of earlier views:
    denoising takes what these have in common for what there is. What is seen is the mean over about 12 x 12
    pixels.
    """
    grid, quarter = grids[0], grids[2]
    row, column, _ = quarter.pixels()
    kind = type(expected)

    def seen_at(index: UInt) -> list[Float]:
        level = dr.gather(kind, light.level, index)
        looked_up = images.at("traced", index), *[among(channels)(index) for channels in candidates]
        samples, first, second, *third = ([_seen(x, level) for x in image] for image in looked_up)
        found = _products(samples, first, second)
        for denoised in third:
            found += _products(samples, first, denoised) + _products(samples, second, denoised)[1:]
        return found + (images.at("count", index) + images.at("earlier", index) if third else [])

    means = block_means(seen_at, grid, row, column, 2)
    dr.eval(means)
    means = box_mean(among(means), quarter, row, column)
    channels = [dr.full(kind, 1, quarter.lanes), dr.log(means[0] + _SAME), *_way(*means[1:3])]
    if len(candidates) == 2:
        return [*channels, dr.log(dr.clip(expected, _LEAST, _MOST))]
    number, earlier = means[-2:]
    apart, along = _way(*means[4:6])
    doublings = dr.log2(dr.clip(number, 1, _MOST_SAMPLES))
    channels += [dr.log(means[3] + _SAME), apart, (along - 0.5) * doublings, *_way(*means[6:8])]
    return [*channels, dr.minimum(earlier / dr.maximum(number, 1), 1)]


def _products(samples: list[Float], one: list[Float], other: list[Float]) -> list[Float]:
    """What another estimate lacks of the samples and how far it is from one, squared, and their product."""
    way = [b - a for a, b in zip(one, other, strict=True)]
    lacks = dr.sum([dr.square(x - b) for x, b in zip(samples, other, strict=True)])
    along = dr.sum([(x - a) * w for x, a, w in zip(samples, one, way, strict=True)])
    return [lacks * (1 / 3), dr.sum([dr.square(w) for w in way]) * (1 / 3), along * (1 / 3)]


def _way(apart: Float, along: Float) -> tuple[Float, Float]:
    return dr.log(apart + _SAME), dr.clip(along / (apart + _SAME), -_FURTHEST, _FURTHEST)


def _seen(radiance: Float, level: Float) -> Float:
    return radiance / (radiance + level)
