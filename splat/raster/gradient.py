"""The gradient of blending, tile by tile."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drjit as dr

from compose.base.arrays import Arrays
from splat.raster.binning import MINIMUM_ALPHA, Bins
from splat.raster.blending import MAXIMUM_ALPHA
from splat.raster.blocks import LOG2_E, Blocks, blended_records, exp2
from splat.raster.projection import Splats

# Sums per splat: the six moments and the three channels of `_Sums`.
_SUMS = 9


def rasterize_backward(arrays: Arrays, splats: Splats, bins: Bins, image: Any, gradient: Any) -> list[Any]:
    """Gradients of a loss with respect to the splats.

    Walks each list front to back once more. With T_m the transmittance in front of splat m, c_m its colour
    and S the light that arrives from behind it, which is the final colour less all that was added up to m:
    d colour / d alpha_m = T_m c_m - S / (1 - alpha_m).

    S is exact to some 1e-7 of the final colour. Behind a splat that is a million times brighter than all
    that lies behind it, gradients are noise of that size.

    Args:
        arrays: the backend's array types.
        splats, bins, image: as given to and returned by `rasterize`.
        gradient: flat array like `image`, derivative of the loss by the radiance; the derivative by the
            opacity is taken to be zero.

    Returns:
        Nine (N,) arrays in the order of `Splats.differentiable`.
    """
    sums = added_sums(arrays, splats, bins, image, gradient, no_sums(arrays, splats))
    return gradients_from_sums(splats, sums)


def no_sums(arrays: Arrays, splats: Splats) -> list[Any]:
    """What `added_sums` adds to first."""
    return [dr.zeros(arrays.plain.Float, dr.width(splats.x)) for _ in range(_SUMS)]


def added_sums(
    arrays: Arrays, splats: Splats, bins: Bins, image: Any, gradient: Any, sums: list[Any]
) -> list[Any]:
    """Adds what the lists of some tiles contribute to the sums that each splat's gradient is made of.

    Args:
        arrays, splats, bins, image, gradient: as for `rasterize_backward`.
        sums: over tiles further up, and to the left in the same row.

    Returns:
        Nine (N,) arrays.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    if not bins.pairs:
        return sums
    block = Blocks(arrays, bins)
    records = blended_records(arrays, splats, bins)
    width = bins.grid.padded_width
    flow, final = block.loaded(gradient, width), block.loaded(image, width)
    behind = [sum(flow[3 * p + c] * final[3 * p + c] for c in range(3)) for p in range(block.pixels)]
    dr.eval(flow, behind)
    # One slot per pair and sum. All lanes of a tile reach a pair together and add in their vector, so that
    # nothing here depends on the timing of threads.
    slots = [dr.zeros(Float, dr.width(bins.splat)) for _ in range(_SUMS)]

    def walk(i: Any, transmittance: list[Any], behind: list[Any], slots: list[Any]) -> tuple[Any, ...]:
        transmittance, behind = list(transmittance), list(behind)
        sums = _block_sums(arrays, block, records.at(i), flow, transmittance, behind)
        unsorted = dr.gather(UInt, bins.unsorted, i)
        for slot, value in zip(slots, sums, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, slot, value, unsorted, mode=dr.ReduceMode.Local)
        return i + 1, transmittance, behind, slots

    state = (block.first, [Float(1) for _ in range(block.pixels)], behind, slots)
    _, _, _, slots = dr.while_loop(
        state,
        lambda i, transmittance, behind, slots: block.is_active(i, transmittance),
        walk,
        mode="symbolic",
    )
    dr.eval(slots)
    return _sum_runs(arrays, bins, slots, sums)


def _block_sums(
    arrays: Arrays,
    block: Blocks,
    splat: SimpleNamespace,
    flow: list[Any],
    transmittance: list[Any],
    behind: list[Any],
) -> list[Any]:
    """Sums over a block's pixels for one splat, and the step past that splat.

    Args:
        arrays: the backend's array types.
        block: the lanes.
        splat: its record.
        flow: derivative of the loss by the radiance, three channels per pixel.
        transmittance: per pixel in front of the splat; on return, behind it.
        behind: per pixel the light from the splat and from behind it, weighted by `flow`; on return, only
            that from behind it.

    Returns:
        Sums of dL/dpower times 1, u, v, u^2, u v, v^2, where power = ln alpha and u and v are those of
        `Blocks.log2_alphas`, and of dL/dcolour times the weight of the pixel, three channels.
    """
    radiance = splat.red, splat.green, splat.blue
    moments = [arrays.plain.Float(0) for _ in range(6)]
    colours = [arrays.plain.Float(0) for _ in range(3)]
    for pixel, (power, u, v) in enumerate(block.log2_alphas(splat)):
        unclamped = exp2(arrays, power)
        alpha = dr.minimum(unclamped, MAXIMUM_ALPHA)
        seen = alpha >= MINIMUM_ALPHA
        alpha = dr.select(seen, alpha, 0)
        weight = alpha * transmittance[pixel]
        here = flow[3 * pixel : 3 * pixel + 3]
        own = sum(here[c] * radiance[c] for c in range(3))
        behind[pixel] = dr.fma(-weight, own, behind[pixel])
        by_alpha = dr.fma(transmittance[pixel], own, -behind[pixel] * dr.rcp(1 - alpha))
        by_power = dr.select(seen & (unclamped < MAXIMUM_ALPHA), by_alpha * alpha, 0)
        transmittance[pixel] = transmittance[pixel] - weight
        _add_moments(moments, by_power, u, v)
        for c in range(3):
            colours[c] = dr.fma(weight, here[c], colours[c])
    return moments + colours


def _add_moments(moments: list[Any], by_power: Any, u: Any, v: Any) -> None:
    """Adds by_power times 1, u, v, u^2, u v, v^2."""
    along_u, along_v = by_power * u, by_power * v
    for k, term in enumerate((by_power, along_u, along_v)):
        moments[k] = moments[k] + term
    moments[3] = dr.fma(along_u, u, moments[3])
    moments[4] = dr.fma(along_u, v, moments[4])
    moments[5] = dr.fma(along_v, v, moments[5])


def _sum_runs(arrays: Arrays, bins: Bins, slots: list[Any], sums: list[Any]) -> list[Any]:
    """(N,) sums over each splat's pairs, added to earlier ones always in the same order."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt

    def add(i: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
        return i + 1, [s + dr.gather(Float, slot, i) for s, slot in zip(sums, slots, strict=True)]

    end = bins.first + bins.count
    state = (UInt(bins.first), [dr.gather(Float, values, bins.owner) for values in sums])
    _, added = dr.while_loop(state, lambda i, sums: i < end, add, mode="symbolic")
    dr.eval(added)
    totals = []
    for values, earlier in zip(added, sums, strict=True):
        total = Float(earlier)
        dr.scatter(total, values, bins.owner, mode=dr.ReduceMode.Permute)
        totals.append(total)
    dr.eval(totals)
    return totals


def gradients_from_sums(splats: Splats, sums: list[Any]) -> list[Any]:
    """Gradients by the splats' parameters from the sums over all tiles, in the order of `_block_sums`.

    power = ln opacity - (x_precision t^2 + y_precision dy^2) / 2 with t = dx + shear dy, and u^2 and v^2 are
    those squares times log2(e) / 2.
    """
    s, su, sv, suu, suv, svv, red, green, blue = sums
    to_x, to_y = (dr.sqrt((2 / LOG2_E) * value) for value in (splats.x_precision, splats.y_precision))
    by_x = to_x * su
    gradients = [
        by_x,
        dr.fma(splats.shear, by_x, to_y * sv),
        suu * dr.rcp(-LOG2_E * splats.x_precision),
        -to_x * suv * dr.rsqrt((0.5 * LOG2_E) * splats.y_precision),
        svv * dr.rcp(-LOG2_E * splats.y_precision),
        dr.select(splats.opacity > 0, s * dr.rcp(dr.maximum(splats.opacity, 1e-12)), 0),
        red,
        green,
        blue,
    ]
    dr.eval(gradients)
    return gradients
