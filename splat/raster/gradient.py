"""The gradient of blending, tile by tile."""

from __future__ import annotations

from typing import Any

import drjit as dr

from splat.base.arrays import Arrays
from splat.raster.binning import MINIMUM_ALPHA, Bins
from splat.raster.blending import MAXIMUM_ALPHA, padded_size
from splat.raster.blocks import Blocks, exp2, fetch, pack, powers
from splat.raster.projection import Splats


def rasterize_backward(arrays: Arrays, splats: Splats, bins: Bins, image: Any, gradient: Any) -> list[Any]:
    """Gradients of a loss with respect to the splats.

    The list is walked front to back once more. With S the light that arrives from behind splat m,
    the final colour less all that was added up to m, d colour / d alpha_m = T_m c_m - S / (1 - alpha_m).

    Args:
        splats, bins, image: as given to and returned by `rasterize`.
        gradient: flat array like `image`, derivative of the loss by the radiance; that by the opacity is
            taken for zero.

    Returns:
        Nine (N,) arrays in the order of `Splats.differentiable`.
    """
    Float, UInt = arrays.plain.Float, arrays.plain.UInt
    count = dr.width(splats.x)
    if not bins.pairs:
        return [dr.zeros(Float, count) for _ in range(9)]
    width, _ = padded_size(bins)
    block = Blocks(arrays, bins)
    packed = pack(arrays, splats, bins)
    flow, final = block.loaded(gradient, width), block.loaded(image, width)
    behind = [sum(flow[3 * p + c] * final[3 * p + c] for c in range(3)) for p in range(block.pixels)]
    dr.eval(flow, behind)
    # One slot per pair and quantity. All lanes of a tile reach a pair together and sum in their vector,
    # so that nothing here depends on the timing of threads.
    slots = [dr.zeros(Float, dr.width(bins.splat)) for _ in range(9)]

    def walk(i: Any, transmittance: list[Any], behind: list[Any], slots: list[Any]) -> tuple[Any, ...]:
        splat = fetch(arrays, packed, i)
        transmittance, behind = list(transmittance), list(behind)
        # Sums over the block's pixels: of dL/dpower times 1, dx, dy, dx^2, dx dy, dy^2, and of
        # the weights times dL/dcolour.
        moments = [Float(0) for _ in range(6)]
        colours = [Float(0) for _ in range(3)]
        for pixel, power in powers(block, splat):
            unclamped = exp2(arrays, power)
            alpha = dr.minimum(unclamped, MAXIMUM_ALPHA)
            seen = alpha >= MINIMUM_ALPHA
            alpha = dr.select(seen, alpha, 0)
            weight = alpha * transmittance[pixel]
            here = flow[3 * pixel : 3 * pixel + 3]
            own = sum(here[c] * splat[6 + c] for c in range(3))
            behind[pixel] = dr.fma(-weight, own, behind[pixel])
            by_alpha = dr.fma(transmittance[pixel], own, -behind[pixel] * dr.rcp(1 - alpha))
            by_power = dr.select(seen & (unclamped < MAXIMUM_ALPHA), by_alpha * alpha, 0)
            transmittance[pixel] = transmittance[pixel] - weight
            dx, dy = block.offset(pixel, splat)
            along_x, along_y = by_power * dx, by_power * dy
            for k, term in enumerate((by_power, along_x, along_y)):
                moments[k] = moments[k] + term
            moments[3] = dr.fma(along_x, dx, moments[3])
            moments[4] = dr.fma(along_x, dy, moments[4])
            moments[5] = dr.fma(along_y, dy, moments[5])
            for c in range(3):
                colours[c] = dr.fma(weight, here[c], colours[c])
        home = dr.gather(UInt, bins.home, i)
        for slot, value in zip(slots, moments + colours, strict=True):
            dr.scatter_reduce(dr.ReduceOp.Add, slot, value, home, mode=dr.ReduceMode.Local)
        return i + 1, transmittance, behind, slots

    state = (block.first, [Float(1) for _ in range(block.pixels)], behind, slots)
    _, _, _, slots = dr.while_loop(
        state, lambda i, transmittance, behind, slots: block.goes_on(i, transmittance), walk, mode="symbolic"
    )
    dr.eval(slots)
    sums = _sum_neighbourhoods(arrays, bins, slots, count)
    return _from_moments(splats, sums)


def _sum_neighbourhoods(arrays: Arrays, bins: Bins, slots: list[Any], count: int) -> list[Any]:
    """Sums each splat's pairs, neighbours before sorting, always in the same order."""
    Float, UInt = arrays.plain.Float, arrays.plain.UInt

    def add(i: Any, sums: list[Any]) -> tuple[Any, list[Any]]:
        return i + 1, [s + dr.gather(Float, slot, i) for s, slot in zip(sums, slots, strict=True)]

    end = bins.first + bins.count
    state = (UInt(bins.first), [dr.zeros(Float, dr.width(bins.first)) for _ in slots])
    _, sums = dr.while_loop(state, lambda i, sums: i < end, add, mode="symbolic")
    dr.eval(sums)
    totals = []
    for values in sums:
        total = dr.zeros(Float, count)
        dr.scatter(total, values, bins.owner, mode=dr.ReduceMode.Permute)
        totals.append(total)
    dr.eval(totals)
    return totals


def _from_moments(splats: Splats, sums: list[Any]) -> list[Any]:
    """Gradients by the splats' own parameters from the sums of dL/dpower; power = ln alpha."""
    s, sx, sy, sxx, sxy, syy, red, green, blue = sums
    gradients = [
        splats.xx * sx + splats.xy * sy,
        splats.xy * sx + splats.yy * sy,
        -0.5 * sxx,
        -sxy,
        -0.5 * syy,
        dr.select(splats.opacity > 0, s * dr.rcp(dr.maximum(splats.opacity, 1e-12)), 0),
        red,
        green,
        blue,
    ]
    dr.eval(gradients)
    return gradients
